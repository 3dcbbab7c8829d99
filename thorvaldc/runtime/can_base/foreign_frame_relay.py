"""Relays frames between other programs and foreign devices on the robot's bus.

The relay passes only frames whose identifiers the robot file lists.  The robot file can also state
a minimum interval between the frames of an identifier.

The relay limits the rate of an identifier with the minimum interval T by a due time.  A frame is
dropped if it arrives more than T/2 before the due time.  Each passed frame changes the due
time to max(due time, arrival time) + T:

    due times   |                   |                   |                   |
    arrivals    x         x    -               x             -      x

    x: the frame passes;  -: the frame is dropped, because the due time is more than T/2 away

The relay therefore tolerates a jitter of half an interval.  The mean rate never exceeds 1/T,
because the due time after an early frame is counted from the old due time, not from the early
arrival.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import Bus
from thorvaldc.runtime.can_base.motor_controller import MASTER

QUEUE_LIMIT = 64
"""Size of the queue in each direction, in frames."""
_ROUNDING = 1e-6
"""Tolerance (s) for the rounding of times."""


class RelayedFrame(NamedTuple):
    """A CAN frame from a foreign device, with its time of reception (s)."""

    time: float
    cob_id: int
    data: bytes


class Relay:
    """Relays frames between other programs and the foreign devices on one bus.

    ``passed`` counts the relayed frames by identifier.  ``dropped`` counts the dropped frames by
    identifier and reason: ``not allowed``, ``too often``, ``too long``, ``muted``, ``queue full``,
    ``not sent``.
    """

    def __init__(self, bus: Bus) -> None:
        frames = [frame for frame in bus.frames if frame.kind == "relay"]
        self.to_device = {f.cob_id: f for f in frames if f.producer == MASTER}
        self.from_device = {f.cob_id: f for f in frames if f.producer != MASTER}
        self.muted = False
        self.passed: Counter[int] = Counter()
        self.dropped: Counter[tuple[int, str]] = Counter()
        self._outgoing: deque[CanFrame] = deque()
        self._incoming: deque[RelayedFrame] = deque()
        self._due: dict[int, float] = {}

    def offer(self, frame: CanFrame, now: float) -> str:
        """Queues a frame from another program for a foreign device.

        Returns the reason if the frame is dropped, or an empty text if the frame is queued.
        """
        definition = self.to_device.get(frame.id)
        reason = ""
        if definition is None or frame.extended or frame.remote:
            reason = "not allowed"
        elif self.muted:
            reason = "muted"
        elif len(frame.data) > definition.length:
            reason = "too long"
        elif not self._within_rate(frame.id, definition.minimum_interval, now):
            reason = "too often"
        elif len(self._outgoing) >= QUEUE_LIMIT:
            reason = "queue full"
        if reason:
            self.dropped[frame.id, reason] += 1
        else:
            self._outgoing.append(frame)
        return reason

    def take(self, cob_id: int, data: bytes, time: float) -> None:
        """Queues a received frame of a foreign device for other programs.

        If the queue is full, the oldest frame in the queue is dropped.
        """
        definition = self.from_device.get(cob_id)
        if definition is None:
            return
        if not self._within_rate(cob_id, definition.minimum_interval, time):
            self.dropped[cob_id, "too often"] += 1
            return
        if len(self._incoming) >= QUEUE_LIMIT:
            oldest = self._incoming.popleft()
            self.dropped[oldest.cob_id, "queue full"] += 1
        self._incoming.append(RelayedFrame(time, cob_id, data))
        self.passed[cob_id] += 1

    def next_outgoing(self) -> CanFrame | None:
        """Removes and returns the oldest frame to send, or ``None`` if the queue is empty."""
        return self._outgoing.popleft() if self._outgoing else None

    def count_sent(self, frame: CanFrame, sent: bool) -> None:
        """Counts a frame of ``next_outgoing`` as passed or dropped.

        ``sent`` is ``False`` if the CAN interface did not accept the frame.
        """
        if sent:
            self.passed[frame.id] += 1
        else:
            self.dropped[frame.id, "not sent"] += 1

    def received(self) -> list[RelayedFrame]:
        """Returns the frames received from foreign devices since the last call of ``received``."""
        frames = list(self._incoming)
        self._incoming.clear()
        return frames

    def mute(self, muted: bool) -> None:
        """Starts or ends the muting of the relay.

        While the relay is muted, no frames are sent to foreign devices, and queued frames are
        dropped.
        """
        self.muted = muted
        while muted and self._outgoing:
            self.dropped[self._outgoing.popleft().id, "muted"] += 1

    def _within_rate(self, cob_id: int, interval: float | None, now: float) -> bool:
        """Returns ``True`` if a frame passes the rate limit, and updates the due time.

        ``interval`` is the minimum interval (s) between two frames, or ``None`` for no limit.
        """
        if interval is None:
            return True
        due = self._due.get(cob_id, now)
        if now < due - 0.5 * interval - _ROUNDING:
            return False
        self._due[cob_id] = max(due, now) + interval
        return True
