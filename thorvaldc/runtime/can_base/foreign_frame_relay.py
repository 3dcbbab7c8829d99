"""Relays CAN frames between other programs and foreign devices on the robot's bus.

Only CAN frames whose identifiers are listed in the robot file are relayed.  The robot file can
limit the rate of a relayed CAN identifier with a minimum interval between the frames.

For each CAN identifier with a minimum interval T, the relay stores the time at which the next frame
is due.  A CAN frame is dropped if it arrives more than half the minimum interval before the due
time.  After each relayed frame the due time is max(due time, arrival time) + T, where T is the
minimum interval:

    due times   |                   |                   |                   |
    arrivals    x         x    -               x             -      x

    x: the frame passes;  -: the frame is dropped, because the due time is more than T/2 away

The relay tolerates a jitter of half the minimum interval.  The mean rate of the relayed frames
never exceeds one frame per minimum interval, because after an early frame the next due time is
counted from the old due time, not from the early arrival.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Bus
from thorvaldc.model.bus import MASTER

QUEUE_LIMIT = 64
"""Size of the queue in each direction, in frames."""
_ROUNDING = 1e-6
"""Tolerance (s) for the rounding of times."""


class RelayedFrame(NamedTuple):
    """A CAN frame from a foreign device, with its time of reception (s)."""

    time: float
    frame: CanFrame


class Relay:
    """Relays CAN frames between other programs and the foreign devices on one bus.

    ``passed``: number of relayed CAN frames by key.  ``dropped``: number of dropped CAN frames by
    key and reason, which is ``not allowed``, ``too often``, ``too long``,
    ``muted``, ``queue full`` or ``not sent``.
    """

    def __init__(self, bus: Bus) -> None:
        frames = [frame for frame in bus.frames if frame.kind == "relay"]
        self.to_device = {f.key: f for f in frames if f.producer == MASTER}
        self.from_device = {f.key: f for f in frames if f.producer != MASTER}
        self.muted = False
        self.passed: Counter[int] = Counter()
        self.dropped: Counter[tuple[int, str]] = Counter()
        self._outgoing: deque[CanFrame] = deque()
        self._incoming: deque[RelayedFrame] = deque()
        self._due: dict[int, float] = {}

    def offer(self, frame: CanFrame, now: float) -> str:
        """Queues a CAN frame from another program for a foreign device.

        Returns the reason if the CAN frame is dropped, or an empty text if the CAN frame is queued.
        """
        definition = self.to_device.get(frame.key)
        reason = ""
        if definition is None or frame.remote:
            reason = "not allowed"
        elif self.muted:
            reason = "muted"
        elif len(frame.data) > definition.length:
            reason = "too long"
        elif not self._within_rate(frame.key, definition.minimum_interval, now):
            reason = "too often"
        elif len(self._outgoing) >= QUEUE_LIMIT:
            reason = "queue full"
        if reason:
            self.dropped[frame.key, reason] += 1
        else:
            self._outgoing.append(frame)
        return reason

    def take(self, key: int, data: bytes, time: float) -> None:
        """Queues a CAN frame received from a foreign device for other programs.

        If the queue is full, the oldest CAN frame in the queue is dropped.
        """
        definition = self.from_device.get(key)
        if definition is None:
            return
        if not self._within_rate(key, definition.minimum_interval, time):
            self.dropped[key, "too often"] += 1
            return
        if len(self._incoming) >= QUEUE_LIMIT:
            oldest = self._incoming.popleft()
            self.dropped[oldest.frame.key, "queue full"] += 1
        frame = CanFrame(definition.cob_id, data, definition.extended)
        self._incoming.append(RelayedFrame(time, frame))
        self.passed[key] += 1

    def next_outgoing(self) -> CanFrame | None:
        """Removes and returns the oldest CAN frame in the queue of frames to send, or returns
        ``None`` if the queue is empty."""
        return self._outgoing.popleft() if self._outgoing else None

    def count_sent(self, frame: CanFrame, sent: bool) -> None:
        """Counts a CAN frame returned by ``next_outgoing`` as relayed or dropped.

        ``sent``: ``False`` if the CAN interface did not accept the CAN frame.
        """
        if sent:
            self.passed[frame.key] += 1
        else:
            self.dropped[frame.key, "not sent"] += 1

    def received(self) -> list[RelayedFrame]:
        """Returns the CAN frames received from foreign devices since the last call of
        ``received``."""
        frames = list(self._incoming)
        self._incoming.clear()
        return frames

    def mute(self, muted: bool) -> None:
        """Mutes or unmutes the relay of CAN frames.

        A muted relay sends no CAN frames to foreign devices and drops the queued CAN frames.
        """
        self.muted = muted
        while muted and self._outgoing:
            self.dropped[self._outgoing.popleft().key, "muted"] += 1

    def _within_rate(self, key: int, interval: float | None, now: float) -> bool:
        """Returns ``True`` if a CAN frame is within the rate limit of its identifier, and updates
        the due time.

        ``interval``: minimum interval (s) between two CAN frames of the identifier, or ``None`` for
        no limit.
        """
        if interval is None:
            return True
        due = self._due.get(key, now)
        if now < due - 0.5 * interval - _ROUNDING:
            return False
        self._due[key] = max(due, now) + interval
        return True
