"""Frames of foreign devices, passed on: those on the list, no oftener than they may come."""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import Bus
from thorvaldc.runtime.can_base.motor_controller import MASTER

WAITING = 64
"""Frames in either direction that wait to be taken."""
_SLACK = 1e-6


class Relayed(NamedTuple):
    """A frame from a foreign device, and when it came (s)."""

    time: float
    cob_id: int
    data: bytes


class Relay:
    """The relay of one bus.  Nothing passes that the robot's file does not name.

    ``dropped`` counts what did not pass, by identifier and reason: ``not allowed``,
    ``too often``, ``too long``, ``muted``, ``waiting`` (nobody took those before), ``not sent``.
    """

    def __init__(self, bus: Bus) -> None:
        frames = [frame for frame in bus.frames if frame.kind == "relay"]
        self.to_device = {f.cob_id: f for f in frames if f.producer == MASTER}
        self.from_device = {f.cob_id: f for f in frames if f.producer != MASTER}
        self.muted = False
        self.passed: Counter[int] = Counter()
        self.dropped: Counter[tuple[int, str]] = Counter()
        self._outgoing: deque[CanFrame] = deque()
        self._incoming: deque[Relayed] = deque()
        self._last: dict[int, float] = {}

    def offer(self, frame: CanFrame, now: float) -> str:
        """A frame for a foreign device; why it is dropped, empty where it will be sent."""
        known = self.to_device.get(frame.id)
        reason = ""
        if known is None or frame.extended or frame.remote:
            reason = "not allowed"
        elif self.muted:
            reason = "muted"
        elif len(frame.data) > known.length:
            reason = "too long"
        elif not self._in_time(frame.id, known.minimum_interval, now):
            reason = "too often"
        elif len(self._outgoing) >= WAITING:
            reason = "waiting"
        if reason:
            self.dropped[frame.id, reason] += 1
        else:
            self._outgoing.append(frame)
        return reason

    def take(self, cob_id: int, data: bytes, time: float) -> None:
        """A frame that a foreign device has sent."""
        known = self.from_device.get(cob_id)
        if known is None:
            return
        if not self._in_time(cob_id, known.minimum_interval, time):
            self.dropped[cob_id, "too often"] += 1
            return
        if len(self._incoming) >= WAITING:
            oldest = self._incoming.popleft()
            self.dropped[oldest.cob_id, "waiting"] += 1
        self._incoming.append(Relayed(time, cob_id, data))
        self.passed[cob_id] += 1

    def to_send(self) -> CanFrame | None:
        """The next frame for the bus, the oldest first."""
        return self._outgoing.popleft() if self._outgoing else None

    def sent(self, frame: CanFrame, taken: bool) -> None:
        if taken:
            self.passed[frame.id] += 1
        else:
            self.dropped[frame.id, "not sent"] += 1

    def received(self) -> list[Relayed]:
        """What foreign devices have sent since it was called last."""
        found = list(self._incoming)
        self._incoming.clear()
        return found

    def mute(self, muted: bool) -> None:
        """Let nothing through to the devices; what waits is dropped."""
        self.muted = muted
        while muted and self._outgoing:
            self.dropped[self._outgoing.popleft().id, "muted"] += 1

    def _in_time(self, cob_id: int, interval: float | None, now: float) -> bool:
        """At most one in an interval, on the average: a little jitter does no harm."""
        if interval is None:
            return True
        due = self._last.get(cob_id, now)
        if now < due - 0.5 * interval - _SLACK:
            return False
        self._last[cob_id] = max(due, now) + interval
        return True
