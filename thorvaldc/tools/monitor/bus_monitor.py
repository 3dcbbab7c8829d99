"""Monitors the traffic on a CAN bus of a robot.

The bus monitor shows the bus load, the age of every CAN frame, the states of the nodes, and EMCY
messages.  The CAN map of the robot model defines the CAN frames that the bus monitor expects.  The
bus monitor never sends CAN frames.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.can import canopen
from thorvaldc.can.frame import NANOSECONDS, CanFrame, CanInterface, ReceivedFrame
from thorvaldc.can.frame_bits import frame_bits
from thorvaldc.model import Bus, FrameDefinition, Node, Robot, Signal
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

WINDOW = 1.0
"""Time (s) over which the bus load is averaged."""
LATE = 1.5
"""Age of the newest frame, in periods, above which a frame is late."""
TOO_OFTEN = 0.7
"""Share of the expected period below which a frame is too frequent.

If a frame is too frequent, two nodes may send the same identifier."""
GAPS, SLOW_GAPS, SLOW = 8, 4, 0.5
"""The measured period is the mean of the last ``GAPS`` times between two frames.

For an expected period of ``SLOW`` seconds or more, only the last ``SLOW_GAPS`` times are used."""
SETTLING, SETTLING_PERIODS = 1.0, 3
"""A frame is judged after it should have been sent for ``SETTLING`` s and ``SETTLING_PERIODS``
periods.

Before, the monitor has not listened for long enough, or the node is still being started."""
POLL_TIME = 0.05
"""Longest time (s) until a key or a termination signal ends the monitoring."""
MOST_EMERGENCIES = 100
"""Largest number of stored EMCY messages."""
MOST_UNKNOWN = 200
"""Largest number of stored identifiers that are not in the CAN map."""


class _FrameRecord:
    """Number, reception times (s) and newest data of the received CAN frames with one
    identifier."""

    def __init__(self, codec: FrameCodec | None = None) -> None:
        self.codec = codec
        self.count = 0
        self.too_short = 0
        self.not_finite = 0
        self.data = b""
        self.complete = False
        self.times: deque[float] = deque(maxlen=GAPS + 1)
        self.signals: dict[str, Signal] = {}
        if codec is not None:
            self.signals = {signal.name: signal for signal in codec.frame.signals}

    @property
    def time(self) -> float:
        return self.times[-1] if self.times else -math.inf

    def period(self, gaps: int = GAPS) -> float:
        """Returns the measured period (s) of a CAN frame, which is the mean of the last ``gaps``
        intervals.

        Returns NaN if fewer than two CAN frames were received.
        """
        gaps = min(gaps, len(self.times) - 1)
        return (self.times[-1] - self.times[-1 - gaps]) / gaps if gaps > 0 else math.nan

    def take(self, time: float, data: bytes) -> None:
        self.count += 1
        self.times.append(time)
        if self.codec is not None and len(data) < self.codec.length:
            self.too_short += 1
        elif self.codec is not None and not self.codec.is_finite(data):
            self.not_finite += 1
        else:
            self.data, self.complete = data, True

    def values(self) -> dict[str, float]:
        """Returns the signal values of the newest complete CAN frame by signal name, in physical
        units."""
        if self.codec is None or not self.complete:
            return {}
        return self.codec.decode_named(self.data)

    def named_values(self) -> dict[str, float | str]:
        """Returns the values of the CAN signals by name.

        The value of an enumerated CAN signal is returned as text.
        """
        values: dict[str, float | str] = {}
        for name, value in self.values().items():
            choices = dict(self.signals[name].choices)
            values[name] = choices.get(int(value), value) if choices else value
        return values


class BusMonitor:
    """Monitor that evaluates the received CAN frames of one bus.

    All times of the bus monitor are in seconds on the clock of the CAN interface.
    """

    def __init__(self, robot: Robot, bus: Bus) -> None:
        self.robot = robot
        self.bus = bus
        self._frames = {frame.key: _FrameRecord(FrameCodec(frame)) for frame in bus.frames}
        self._unknown: dict[tuple[int, bool], _FrameRecord] = {}
        self._emergencies: deque[dict[str, Any]] = deque(maxlen=MOST_EMERGENCIES)
        self._recent: deque[tuple[float, int]] = deque()
        self._bits = 0
        self._highest_load = 0.0
        self._first_time = math.nan
        self._start = math.nan  # time of the first frame or of the first summary
        self._operational_since: dict[str, float] = {}
        self.total = 0
        self.unknown_lost = 0
        """Number of frames that are neither in the CAN map nor stored as unknown identifiers."""

    def take(self, received: ReceivedFrame) -> None:
        """Updates the state of the bus monitor with a received CAN frame."""
        time, frame = received.time / NANOSECONDS, received.frame
        if math.isnan(self._first_time):
            self._first_time = time
        self._begin(time)
        self.total += 1
        self._count_bits(time, frame)
        record = None if frame.remote else self._frames.get(frame.key)
        if record is None:
            key = (frame.id, frame.extended)
            record = self._unknown.get(key)
            if record is None and len(self._unknown) >= MOST_UNKNOWN:
                self.unknown_lost += 1
                return
            if record is None:
                record = self._unknown[key] = _FrameRecord()
        record.take(time, frame.data)
        if record.codec is not None and record.codec.frame.kind == "emcy":
            self._emergency(time, record.codec.frame, frame.data)
        if record.codec is not None and record.codec.frame.kind == "heartbeat" and frame.data:
            self._note_state(time, record.codec.frame.producer, frame.data)

    def summary(self, now: float) -> dict[str, Any]:
        """Returns the measured state of the CAN bus as JSON values.

        All quantities are in SI units, and bus loads are fractions from 0 to 1.  The value of an
        unknown quantity is ``None``.  The last element of the list ``emergencies`` is the newest
        EMCY message.
        """
        self._begin(now)
        self._drop_old_bits(now)
        span = min(max(now - self._first_time, 1e-3), WINDOW) if self.total else WINDOW
        load = self._bits / (self.bus.bitrate * span)
        if self.total and now - self._first_time >= WINDOW:
            self._highest_load = max(self._highest_load, load)
        return {
            "time": now,
            "robot": self.robot.name,
            "bus": self.bus.name,
            "bitrate": self.bus.bitrate,
            "load": load,
            # Before the first window is complete, the load is the only one.
            "highest_load": self._highest_load or load,
            "load_budget": self.bus.load,
            "frames_per_second": len(self._recent) / span,
            "frames_total": self.total,
            "nodes": [self._node(node, now) for node in self.bus.nodes],
            "frames": [
                self._frame(frame, now)
                for frame in self.bus.frames
                if frame.period is not None or self._frames[frame.key].count
            ],
            "emergencies": list(self._emergencies),
            "unknown": [
                {
                    "id": identifier,
                    "extended": extended,
                    "count": record.count,
                    "age": max(now - record.time, 0.0),
                    "period": _finite(record.period()),
                    "data": record.data.hex(),
                }
                for (identifier, extended), record in sorted(self._unknown.items())
            ],
        }

    # -- inside --------------------------------------------------------------------------------

    def _begin(self, time: float) -> None:
        if math.isnan(self._start):
            self._start = time

    def _note_state(self, time: float, node: str, data: bytes) -> None:
        if canopen.heartbeat_state(data) == canopen.NmtState.OPERATIONAL:
            self._operational_since.setdefault(node, time)
        else:
            self._operational_since.pop(node, None)

    def _is_judged(self, frame: FrameDefinition, now: float) -> bool:
        """Returns whether the frame should have been sent for long enough to be judged.

        A node whose heartbeat was received sends PDOs only while it is operational.
        """
        start = self._started(frame)
        start = self._start if start is None else start
        return now - start >= _settling(frame)

    def _started(self, frame: FrameDefinition) -> float | None:
        """Returns the time at which a node that sends heartbeats began to send its PDO, or infinity
        if the node is not operational; ``None`` for all other frames."""
        if frame.kind != "pdo" or not self._sends_heartbeats(frame.producer):
            return None
        return self._operational_since.get(frame.producer, math.inf)

    def _sends_heartbeats(self, node: str) -> bool:
        records = (r for r in self._frames.values() if r.codec and r.count)
        return any(
            r.codec is not None
            and r.codec.frame.kind == "heartbeat"
            and r.codec.frame.producer == node
            for r in records
        )

    def _count_bits(self, time: float, frame: CanFrame) -> None:
        bits = frame_bits(frame)
        self._recent.append((time, bits))
        self._bits += bits
        self._drop_old_bits(time)

    def _drop_old_bits(self, now: float) -> None:
        recent = self._recent
        while recent and recent[0][0] < now - WINDOW:
            self._bits -= recent.popleft()[1]

    def _emergency(self, time: float, frame: FrameDefinition, data: bytes) -> None:
        try:
            emergency = canopen.Emergency.unpack(data)
        except ValueError:
            return  # the frame is counted as too short
        self._emergencies.append(
            {
                "time": time,
                "node": frame.producer,
                "code": emergency.error_code,
                "register": emergency.register,
                "data": emergency.data.hex(),
                "over": emergency.error_code == 0,
            }
        )

    def _node(self, node: Node, now: float) -> dict[str, Any]:
        records = [self._frames[f.key] for f in self.bus.frames if f.producer == node.name]
        heartbeats = [r for r in records if r.codec and r.codec.frame.kind == "heartbeat"]
        last_time = max((r.time for r in records), default=-math.inf)
        summary: dict[str, Any] = {
            "name": node.name,
            "id": node.id,
            "protocol": node.protocol,
            "nmt": None,
            "heard": _finite(max(now - last_time, 0.0)),
            "silent": False,
            "drive": _drive_states(node, records),
        }
        for heartbeat in heartbeats:
            if heartbeat.count and heartbeat.data:
                summary["nmt"] = canopen.nmt_state_text(canopen.heartbeat_state(heartbeat.data))
            timeout = node.heartbeat_timeout
            last = max(heartbeat.time, self._start)
            summary["silent"] = timeout is not None and not now - last <= timeout
        return summary

    def _frame(self, frame: FrameDefinition, now: float) -> dict[str, Any]:
        record = self._frames[frame.key]
        values = record.named_values()
        return {
            "id": frame.cob_id,
            "extended": frame.extended,
            "name": frame.name,
            "producer": frame.producer,
            "count": record.count,
            "age": _finite(max(now - record.time, 0.0)),
            "period": _finite(record.period()),
            "period_expected": frame.period,
            "problem": self._problem(frame, record, now),
            "values": values,
            "units": {n: s.unit for n, s in record.signals.items() if n in values and s.unit},
            "flags": [n for n, s in record.signals.items() if n in values and s.length == 1],
        }

    def _problem(self, frame: FrameDefinition, record: _FrameRecord, now: float) -> str:
        """Returns a message about missing or wrong CAN frames with one identifier, or an empty
        text."""
        if record.too_short:
            return f"{record.too_short} of {record.count} too short"
        if record.not_finite:
            return f"{record.not_finite} of {record.count} with a number that is not finite"
        expected = frame.period
        if expected is None:
            return ""
        if self._is_judged(frame, now):
            if not record.count:
                return "never"
            if now - record.time > LATE * expected:
                return "late"
        gaps = GAPS if expected < SLOW else SLOW_GAPS
        if record.count <= gaps or record.period(gaps) >= TOO_OFTEN * expected:
            return ""
        # A node that is being started sends its PDOs more often.
        started = self._started(frame)
        settled = started is None or record.times[-1 - gaps] >= started + _settling(frame)
        return "too often" if settled else ""


def watch(
    interface: CanInterface,
    monitor: BusMonitor,
    interval: float,
    show: Callable[[Mapping[str, Any]], None],
    *,
    until: float = math.inf,
    ended: Callable[[], bool] = lambda: False,
) -> None:
    """Receives CAN frames, and calls ``show`` with a summary of the bus in regular intervals.

    - ``interval``: time (s) between two calls of ``show``;
    - ``until``: time (s) on the clock of the interface at which the function returns;
    - ``ended``: function that returns ``True`` to end the monitoring.

    Raises ``ConnectionError`` if the connection to the CAN interface is lost.
    """
    next_summary = interface.now + interval
    while not ended():
        now = interface.now
        if now >= min(next_summary, until) - 1e-9:
            summary = monitor.summary(now)
            summary["controller"] = interface.state.value
            summary["overruns"] = interface.overruns
            show(summary)
            next_summary = max(next_summary + interval, now)
            if now >= until - 1e-9:
                return
        timeout = max(min(POLL_TIME, min(next_summary, until) - now), 0.0)
        received = interface.receive(timeout)
        while received is not None:
            monitor.take(received)
            if interface.now >= next_summary:
                break
            received = interface.receive(0.0)


def _settling(frame: FrameDefinition) -> float:
    """Returns the time (s) after which a frame that should have been sent is judged."""
    return max(SETTLING, SETTLING_PERIODS * (frame.period or 0.0))


def _drive_states(node: Node, records: list[_FrameRecord]) -> dict[str, str | None]:
    """Returns the CiA 402 power state of each motor channel of a node, and the reported flags that
    are set.

    The keys of the returned dictionary are the names of motor channels and flags.  In the returned
    dictionary the value of a flag is ``None``.  The returned dictionary is empty for a node without
    motors.
    """
    states: dict[str, str | None] = {}
    if not node.channels:
        return states
    for record in records:
        if record.codec is None or record.codec.frame.kind != "pdo":
            continue
        for name, value in record.values().items():
            if name.endswith("statusword"):
                channel = name.removesuffix("statusword").strip("_") or "drive"
                states[channel] = _drive_state(int(value))
            elif record.signals[name].length == 1 and value:
                states[name] = None
    return states


def _drive_state(status_word: int) -> str:
    state = canopen.DriveState.of(status_word)
    return f"{status_word:#06x}" if state is None else state.name.lower().replace("_", " ")


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
