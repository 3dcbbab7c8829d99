"""What goes on on a robot's bus, by its map: heard only, nothing is ever sent."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.can.cia402 import DriveState
from thorvaldc.can.frame import CanFrame, ReceivedFrame, frame_bits
from thorvaldc.can.interface import CanInterface
from thorvaldc.model import Robot
from thorvaldc.model.bus import Bus, FrameDefinition, Node, Signal
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

WINDOW = 1.0
"""s over which the bus's load is taken."""
LATE = 1.5
"""Periods without a frame after which it is late."""
TOO_OFTEN = 0.7
"""Share of its period at which a frame comes too often: from two senders, perhaps."""
GAPS, SLOW_GAPS, SLOW = 8, 4, 0.5
"""Between frames, whose mean is the period; fewer of those with a period from ``SLOW`` (s) on."""
MOST_EMERGENCIES = 100
MOST_UNKNOWN = 200
_NANOSECONDS = 1e9

NMT_STATES = {0x00: "boot-up", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}


class _Heard:
    """One identifier: how often, when and what."""

    def __init__(self, codec: FrameCodec | None = None) -> None:
        self.codec = codec
        self.count = 0
        self.short = 0
        self.data = b""
        self.whole = False
        self.times: deque[float] = deque(maxlen=GAPS + 1)
        self.signals: dict[str, Signal] = {}
        if codec is not None:
            self.signals = {signal.name: signal for signal in codec.frame.signals}

    @property
    def time(self) -> float:
        return self.times[-1] if self.times else -math.inf

    def period(self, gaps: int = GAPS) -> float:
        """Mean of the last so many gaps, s; NaN before there are two frames."""
        gaps = min(gaps, len(self.times) - 1)
        return (self.times[-1] - self.times[-1 - gaps]) / gaps if gaps > 0 else math.nan

    def take(self, time: float, data: bytes) -> None:
        self.count += 1
        self.times.append(time)
        if self.codec is not None and len(data) < self.codec.length:
            self.short += 1
        else:
            self.data, self.whole = data, True

    def values(self) -> dict[str, float]:
        """By name, in physical units, of the last frame that was long enough."""
        return self.codec.decode_named(self.data) if self.codec is not None and self.whole else {}

    def shown_values(self) -> dict[str, float | str]:
        """The same, with the names of values where the map has them."""
        found: dict[str, float | str] = {}
        for name, value in self.values().items():
            choices = dict(self.signals[name].choices)
            found[name] = choices.get(int(value), value) if choices else value
        return found


class BusMonitor:
    """Takes in the frames of one bus; ``summary`` says what they tell.

    Times are s of the port's clock.
    """

    def __init__(self, robot: Robot, bus: Bus) -> None:
        self.robot = robot
        self.bus = bus
        self._frames = {frame.cob_id: _Heard(FrameCodec(frame)) for frame in bus.frames}
        self._unknown: dict[tuple[int, bool], _Heard] = {}
        self._emergencies: deque[dict[str, Any]] = deque(maxlen=MOST_EMERGENCIES)
        self._recent: deque[tuple[float, int]] = deque()
        self._bits = 0
        self._highest = 0.0
        self._first = math.nan
        self.total = 0
        self.unknown_lost = 0
        """Identifiers beyond the most that are kept."""

    def take(self, received: ReceivedFrame) -> None:
        """A frame that was heard; the program's own do not occur."""
        time, frame = received.time / _NANOSECONDS, received.frame
        if math.isnan(self._first):
            self._first = time
        self.total += 1
        self._count_bits(time, frame)
        heard = None if frame.extended or frame.remote else self._frames.get(frame.id)
        if heard is None:
            key = (frame.id, frame.extended)
            heard = self._unknown.get(key)
            if heard is None and len(self._unknown) >= MOST_UNKNOWN:
                self.unknown_lost += 1
                return
            if heard is None:
                heard = self._unknown[key] = _Heard()
        heard.take(time, frame.data)
        if heard.codec is not None and heard.codec.frame.kind == "emcy":
            self._emergency(time, heard.codec.frame, frame.data)

    def summary(self, now: float) -> dict[str, Any]:
        """All of it as plain values; ``None``: not known.  SI; shares 0..1.

        ``emergencies`` are the last ones, the newest last.
        """
        self._forget(now)
        span = min(max(now - self._first, 1e-3), WINDOW) if self.total else WINDOW
        load = self._bits / (self.bus.bitrate * span)
        if self.total and now - self._first >= WINDOW:
            self._highest = max(self._highest, load)
        return {
            "time": now,
            "robot": self.robot.name,
            "bus": self.bus.name,
            "bitrate": self.bus.bitrate,
            "load": load,
            "highest_load": self._highest,
            "load_budget": self.bus.load,
            "frames_per_second": len(self._recent) / span,
            "frames_total": self.total,
            "nodes": [self._node(node, now) for node in self.bus.nodes],
            "frames": [
                self._frame(frame, now)
                for frame in self.bus.frames
                if frame.period is not None or self._frames[frame.cob_id].count
            ],
            "emergencies": list(self._emergencies),
            "unknown": [
                {
                    "id": identifier,
                    "extended": extended,
                    "count": heard.count,
                    "age": max(now - heard.time, 0.0),
                    "period": _known(heard.period()),
                    "data": heard.data.hex(),
                }
                for (identifier, extended), heard in sorted(self._unknown.items())
            ],
        }

    # -- inside --------------------------------------------------------------------------------

    def _count_bits(self, time: float, frame: CanFrame) -> None:
        bits = frame_bits(frame)
        self._recent.append((time, bits))
        self._bits += bits
        self._forget(time)

    def _forget(self, now: float) -> None:
        recent = self._recent
        while recent and recent[0][0] < now - WINDOW:
            self._bits -= recent.popleft()[1]

    def _emergency(self, time: float, frame: FrameDefinition, data: bytes) -> None:
        code = int.from_bytes(data[:2], "little")
        self._emergencies.append(
            {
                "time": time,
                "node": frame.producer,
                "code": code,
                "register": data[2] if len(data) > 2 else None,
                "data": data[3:].hex(),
                "over": code == 0,
            }
        )

    def _node(self, node: Node, now: float) -> dict[str, Any]:
        own = [self._frames[f.cob_id] for f in self.bus.frames if f.producer == node.name]
        beats = [h for h in own if h.codec is not None and h.codec.frame.kind == "heartbeat"]
        last = max((h.time for h in own), default=-math.inf)
        found: dict[str, Any] = {
            "name": node.name,
            "id": node.id,
            "protocol": node.protocol,
            "nmt": None,
            "heard": _known(max(now - last, 0.0)),
            "silent": False,
            "drive": _drive(node, own),
        }
        for beat in beats:
            if beat.count and beat.data:
                found["nmt"] = NMT_STATES.get(beat.data[0] & 0x7F, f"{beat.data[0]:#04x}")
            limit = node.heartbeat_timeout
            found["silent"] = limit is not None and not now - beat.time <= limit
        return found

    def _frame(self, frame: FrameDefinition, now: float) -> dict[str, Any]:
        heard = self._frames[frame.cob_id]
        values = heard.shown_values()
        return {
            "id": frame.cob_id,
            "name": frame.name,
            "producer": frame.producer,
            "count": heard.count,
            "age": _known(max(now - heard.time, 0.0)),
            "period": _known(heard.period()),
            "period_expected": frame.period,
            "problem": _problem(frame, heard, now - heard.time),
            "values": values,
            "units": {n: s.unit for n, s in heard.signals.items() if n in values and s.unit},
            "flags": [n for n, s in heard.signals.items() if n in values and s.length == 1],
        }


def watch(
    port: CanInterface,
    monitor: BusMonitor,
    interval: float,
    tell: Callable[[Mapping[str, Any]], None],
    *,
    until: float = math.inf,
    ended: Callable[[], bool] = lambda: False,
    patience: float = 0.05,
) -> None:
    """Listen until the port's clock is at ``until`` (s) or it is ``ended``.

    The summary is told every ``interval`` s; ``ended`` is asked every ``patience`` s at least.
    Raises ``ConnectionError`` where the interface is lost.
    """
    following = port.now + interval
    while not ended():
        now = port.now
        if now >= min(following, until) - 1e-9:
            found = monitor.summary(now)
            found["controller"] = port.state.value
            found["overruns"] = port.overruns
            tell(found)
            following = max(following + interval, now)
            if now >= until - 1e-9:
                return
        received = port.receive(max(min(patience, min(following, until) - now), 0.0))
        while received is not None:
            monitor.take(received)
            if port.now >= following:
                break
            received = port.receive(0.0)


def _problem(frame: FrameDefinition, heard: _Heard, age: float) -> str:
    if heard.short:
        return f"{heard.short} of {heard.count} too short"
    expected = frame.period
    if expected is None:
        return ""
    if not heard.count:
        return "never"
    if age > LATE * expected:
        return "late"
    gaps = GAPS if expected < SLOW else SLOW_GAPS
    if heard.count > gaps and heard.period(gaps) < TOO_OFTEN * expected:
        return "too often"
    return ""


def _drive(node: Node, own: list[_Heard]) -> dict[str, str | None]:
    """The states of a controller's channels, and the flags that are set; empty for others."""
    found: dict[str, str | None] = {}
    if not node.channels:
        return found
    for heard in own:
        if heard.codec is None or heard.codec.frame.kind != "pdo":
            continue
        for name, value in heard.values().items():
            signal = heard.signals[name]
            if name.endswith("statusword"):
                found[name.removesuffix("statusword").strip("_") or "drive"] = _state(int(value))
            elif signal.length == 1 and value:
                found[name] = None
    return found


def _state(statusword: int) -> str:
    """By the bits of CiA 402; bit 5 counts in the four states that need it alone."""
    for state in DriveState:
        mask = 0x6F if state.value & 0x01 and state.value != 0x0F else 0x4F
        if statusword & mask == state.value:
            return state.name.lower().replace("_", " ")
    return f"{statusword:#06x}"


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
