"""Relays frames between other programs and foreign devices on the robot's bus.

Only frames that the robot file lists pass, and each no more often than its rate.

Rate rule.  Frames of an identifier with interval T are expected at due times.  A frame may arrive
up to T/2 before the next due time; an earlier one is dropped.  Each passed frame moves the due time
by T, from the old due time or from its arrival, whichever is later:

    due times   |                   |                   |                   |
    arrivals    x         x    -               x             -      x

    x passes; - is dropped: the next due time is more than T/2 away

So jitter of half a period does no harm.  The mean rate never exceeds 1/T, because an early frame
does not make the next due time earlier.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import Bus
from thorvaldc.runtime.can_base.motor_controller import MASTER

QUEUE_LIMIT = 64
"""Frames that wait in each direction."""
_ROUNDING = 1e-6
"""s.  Tolerance for the rounding of times."""


class RelayedFrame(NamedTuple):
    """A frame from a foreign device, and the time (s) at which it came."""

    time: float
    cob_id: int
    data: bytes


class Relay:
    """The relay of one bus.

    ``dropped`` counts the frames that did not pass, by identifier and reason: ``not allowed``,
    ``too often``, ``too long``, ``muted``, ``queue full``, ``not sent``.
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
        """Queues a frame for a foreign device.

        Returns the reason why it is dropped; empty: it will be sent.
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
        """Queues a frame that a foreign device has sent; a full queue drops its oldest frame."""
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
        """Removes and returns the oldest frame to send; ``None``: there is none."""
        return self._outgoing.popleft() if self._outgoing else None

    def count_sent(self, frame: CanFrame, sent: bool) -> None:
        """Counts a frame of ``next_outgoing``; ``sent`` ``False``: the send queue was full."""
        if sent:
            self.passed[frame.id] += 1
        else:
            self.dropped[frame.id, "not sent"] += 1

    def received(self) -> list[RelayedFrame]:
        """Removes and returns the frames of foreign devices since the last call."""
        frames = list(self._incoming)
        self._incoming.clear()
        return frames

    def mute(self, muted: bool) -> None:
        """Sends nothing to foreign devices while ``muted``; drops the frames that wait."""
        self.muted = muted
        while muted and self._outgoing:
            self.dropped[self._outgoing.popleft().id, "muted"] += 1

    def _within_rate(self, cob_id: int, interval: float | None, now: float) -> bool:
        """Applies the rate rule; ``interval`` (s), ``None``: without limit."""
        if interval is None:
            return True
        due = self._due.get(cob_id, now)
        if now < due - 0.5 * interval - _ROUNDING:
            return False
        self._due[cob_id] = max(due, now) + interval
        return True
