"""Detects motor controllers that restart, leave OPERATIONAL, stop sending, or exist twice.

The watchdog detects missing heartbeats and missing reports of the motor controllers.  If the
watchdog detects a problem, the state machine of the base enters the state FAULT.

    heartbeat   |----T----|----T----|
    received    x         x         (nothing)                   T: period of the node, 100 ms
    age         0         0         T         2T        3T  --> "no heartbeat for ... ms"
                                                                or earlier: heartbeat_timeout

    report      |-T-|-T-|-T-|
    received    x   x   (nothing)                               T: sync period, 20 ms
    age         0   0   T   2T  2.5T --> "no tpdo1 for ... ms"

The watchdog tolerates one missing report of a motor controller, but not two missing reports in a
row.

A program that runs late must not be taken for a silent node:

- In a late control cycle the watchdog does not check for silence, in at most ``LATE_CYCLES``
  cycles in a row.
- The age of a frame is its age at the time until which all frames were read, not at the present
  time.  The receiving thread may be at most ``LATE_CYCLES`` periods late, and not after a late
  cycle.
- The process of a simulated bus may be at most ``LONGEST_DELAY`` late, see ``BusConnection``.

    bus        x   x   x   x   x   x   x           x: reports
    read       x   x   x   x   |                   the receiving thread runs late
    age                        T       now         judged here: T, and not 3 T

A node sends one boot-up message at each start.  Each boot-up message after the first one means that
the node has restarted, or that a second device with the same node id was switched on.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from thorvaldc.can import sdo
from thorvaldc.can.canopen import NmtState, heartbeat_state, nmt_state_text
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Bus, FrameDefinition, ObjectValue
from thorvaldc.model.bus_identity import SERIAL_NUMBER
from thorvaldc.model.stopping import HEARTBEAT_TIMEOUT, LATE_CYCLES, REPORT_TIMEOUT
from thorvaldc.runtime.can_base.base_fault import Cause, Fault
from thorvaldc.runtime.can_base.frame_receiver import LatestFrame, second_device
from thorvaldc.runtime.can_base.motor_controller import MotorController

BOOT_TIME = 0.05
"""Time (s) in which no node can boot twice.

A boot-up message that is repeated within this time was repeated by an error on the bus, or comes
from a second device, whose heartbeats are counted."""
LATE_CYCLE = 1.5
"""Time between two control cycles, in periods, above which the second cycle is late."""


class Heartbeat(NamedTuple):
    """The newest heartbeat of a node, with the time of reception (s) and the NMT state."""

    time: float
    state: int


class _Report(NamedTuple):
    """A PDO that a motor controller sends periodically.

    - ``key``: key of the PDO;
    - ``name``: name of the PDO, for example ``tpdo1``;
    - ``period``: period in s.
    """

    key: int
    name: str
    period: float


class NodeWatchdog:
    """Watchdog for the motor controllers of one CAN bus.

    ``latest``: newest received CAN frame of each key.  Heartbeats and boot-up messages of
    the nodes are always evaluated.  Missing heartbeats and missing reports are detected only after
    ``start`` and before ``stop``.
    """

    def __init__(
        self,
        bus: Bus,
        controllers: Sequence[MotorController],
        latest: Mapping[int, LatestFrame],
    ) -> None:
        self._controllers = {c.node.name: c for c in controllers}
        self._latest = latest
        self._cycle_period = bus.sync_period
        heartbeats = [
            f for f in bus.frames if f.kind == "heartbeat" and f.producer in self._controllers
        ]
        self.heartbeat_frames = {frame.key: frame for frame in heartbeats}
        self._heartbeat_of = {frame.producer: frame for frame in heartbeats}
        self._reports = {name: _reports(bus, name) for name in self._controllers}
        self.malformed_since: dict[int, float] = {}
        """Time (s) of the first of the malformed frames in a row, by key.

        A malformed report counts as missing: its values are unknown."""
        self._heartbeats: dict[str, Heartbeat] = {}
        self._restarted: set[str] = set()
        self._boot_ups: dict[str, int] = {}
        self._booted_at: dict[str, float] = {}
        """Time (s) of the newest boot-up message, by name of the node."""
        self._allowed_boot_ups: dict[str, int] = {}
        self._started_at = math.inf
        self._last_cycle = math.inf
        self._received_until = -math.inf
        self._judged_at = -math.inf
        self._late_cycles = 0

    # -- input -------------------------------------------------------------------------------------

    def begin_cycle(self, now: float, received_until: float, drained_until: float) -> None:
        """Measures the time since the last control cycle.

        - ``received_until``: time (s) up to which all frames have reached the CAN interface;
        - ``drained_until``: time (s) up to which all frames have been read from it.
        """
        # The receiving thread had one cycle for the frames that had arrived at the last cycle.
        earliest = self._received_until - (LATE_CYCLES - 1) * self._cycle_period
        self._received_until = min(received_until, now)
        read_until = self._received_until if self._late_cycles else max(drained_until, earliest)
        self._judged_at = min(read_until, self._received_until)
        late = now - self._last_cycle > LATE_CYCLE * self._cycle_period
        self._late_cycles = self._late_cycles + 1 if late else 0
        self._last_cycle = now

    def take_heartbeat(self, key: int, data: bytes, time: float) -> None:
        """Stores a heartbeat of a node.

        After a boot-up message, the driver of the node is reset.  So it is after heartbeats were
        missing, or if a running node is suddenly not operational: the node may have restarted while
        its boot-up message was lost, for example because the driver itself was off the bus.  It has
        then lost its zero position.
        """
        if not data:
            return
        definition = self.heartbeat_frames[key]
        name, state = definition.producer, heartbeat_state(data)
        last = self._heartbeats.get(name)
        if last is not None and definition.period is not None:
            controller = self._controllers[name]
            was_missing = time - last.time > _heartbeat_limit(controller, definition.period)
            stopped = time > self._started_at and last.state == NmtState.OPERATIONAL != state
            if was_missing or stopped:
                controller.handle_restart()
        if state == NmtState.INITIALISING:
            self._controllers[name].handle_restart()
            self._restarted.add(name)
            self._booted_at[name] = time
            if last is None or last.state != state or time - last.time > BOOT_TIME:
                self._boot_ups[name] = self._boot_ups.get(name, 0) + 1
        self._heartbeats[name] = Heartbeat(time, state)

    def start(self, now: float) -> None:
        """Starts to detect missing heartbeats and reports at ``now`` (s).

        Restarts of motor controllers before ``now`` are ignored.
        """
        self._started_at = now
        self._restarted.clear()

    def stop(self) -> None:
        self._started_at = math.inf

    def allow_boot_ups(self, number: int) -> None:
        """Allows ``number`` further boot-up messages of each node, and forgets the earlier ones."""
        self._boot_ups.clear()
        self._allowed_boot_ups = dict.fromkeys(self._controllers, number)

    # -- output ------------------------------------------------------------------------------------

    def problem(self, controller: MotorController, now: float) -> Fault | None:
        """Returns a problem of a motor controller that must stop the robot, or ``None``."""
        name = controller.node.name
        if name in self._restarted:
            return Fault(Cause.RESTART, "it restarted", name)
        if reason := controller.problem or controller.encoder_jump(now):
            return Fault(Cause.DRIVE, reason, name)
        silence = self._silence(controller)
        return Fault(Cause.SILENCE, silence, name) if silence else None

    @property
    def has_boot_ups(self) -> bool:
        """``True`` if a boot-up message was received since ``allow_boot_ups`` was called."""
        return bool(self._boot_ups)

    def boot_up_problem(self, controller: MotorController) -> str:
        """Returns a message if a node has sent too many boot-up messages during the start-up of the
        base, or an empty text."""
        name = controller.node.name
        if self._boot_ups.get(name, 0) <= self._allowed_boot_ups.get(name, 1):
            return ""
        return f"it restarted during the start-up; {second_device(controller.node.id)}"

    def has_booted(self, controller: MotorController, since: float) -> bool:
        """Returns ``True`` if a node has sent a boot-up message after ``since`` (s)."""
        return self._booted_at.get(controller.node.name, -math.inf) > since

    def is_silent(self, controller: MotorController) -> bool:
        """Returns ``True`` if a node that must send heartbeats has never sent a heartbeat."""
        name = controller.node.name
        return name in self._heartbeat_of and name not in self._heartbeats

    def has_all_reports(self, controller: MotorController) -> bool:
        """Returns ``True`` if each periodic report of the motor controller was received at least
        once, and the newest of each is not malformed."""
        return all(
            r.key in self._latest and r.key not in self.malformed_since
            for r in self._reports[controller.node.name]
        )

    def is_in_state(self, controller: MotorController, state: NmtState, since: float) -> bool:
        """Returns ``True`` if the newest heartbeat of a node reports the NMT state ``state`` and
        was received after ``since``.

        ``since``: time (s) after which the heartbeat must be received.  Returns ``True`` for a node
        without heartbeat, because the NMT state of such a node cannot be checked.
        """
        name = controller.node.name
        if name not in self._heartbeat_of:
            return True
        heartbeat = self._heartbeats.get(name)
        return heartbeat is not None and heartbeat.state == state and heartbeat.time > since

    # -- inside ------------------------------------------------------------------------------------

    def _silence(self, controller: MotorController) -> str:
        """Returns a message about a missing heartbeat or report, or about a wrong NMT state.

        Returns an empty text if the watchdog has detected no problem.
        """
        since, now = self._started_at, self._judged_at
        if since == math.inf or 0 < self._late_cycles <= LATE_CYCLES:
            return ""
        name = controller.node.name
        definition = self._heartbeat_of.get(name)
        if definition is not None and definition.period is not None:
            heartbeat = self._heartbeats.get(name, Heartbeat(-math.inf, NmtState.INITIALISING))
            age = now - max(heartbeat.time, since)
            if age > _heartbeat_limit(controller, definition.period):
                return f"no heartbeat for {age * 1000:.0f} ms"
            if heartbeat.state != NmtState.OPERATIONAL and heartbeat.time > since:
                return f"its NMT state is {nmt_state_text(heartbeat.state)}, not operational"
        for report in self._reports[name]:
            frame = self._latest.get(report.key)
            malformed_since = self.malformed_since.get(report.key, math.inf)
            received_at = -math.inf if frame is None else min(frame.time, malformed_since)
            age = now - max(since, received_at)
            if age / report.period > REPORT_TIMEOUT:
                valid = "valid " if malformed_since < math.inf else ""
                return f"no {valid}{report.name} for {age * 1000:.0f} ms"
        return ""


def _heartbeat_limit(controller: MotorController, period: float) -> float:
    """Returns the longest allowed time (s) between two heartbeats of a motor controller."""
    limit = HEARTBEAT_TIMEOUT * period
    timeout = controller.node.heartbeat_timeout
    return limit if timeout is None else min(limit, timeout)


def _reports(bus: Bus, node: str) -> tuple[_Report, ...]:
    return tuple(
        _Report(frame.key, frame.name.removeprefix(f"{node}_"), frame.period)
        for frame in bus.frames
        if _is_report(frame, node) and frame.period is not None
    )


def _is_report(frame: FrameDefinition, node: str) -> bool:
    return frame.producer == node and frame.kind == "pdo"


# -- reads objects of a node by SDO, and compares them with the robot file ----------------------

ANSWER_TIME = 0.1
"""Time (s) after which a request without a response is repeated."""
TRIES = 3


class ObjectReadback:
    """Reads object dictionary entries of a node one after another, and compares the values with the
    robot file.

    All object dictionary entries are numbers of up to 4 bytes.  A node sends such a number in the
    response to the upload request, or in one segment afterwards.  The comparison of the object
    dictionary ends at the first mismatch.
    The values in the object dictionary are never changed.
    """

    def __init__(self, request: int, response: int, expected: Iterable[ObjectValue]) -> None:
        """Prepares the comparison of the object dictionary entries in ``expected``.

        ``request``: COB-ID of the SDO requests to the node.  ``response``: COB-ID of the SDO
        responses of the node.
        """
        self.request = request
        self.response = response
        self.problem = ""
        """First mismatch, or the reason why an object cannot be read, or an empty text."""
        self.serial: int | None = None
        """Serial number of the node, if it was read."""
        self._remaining = list(expected)[::-1]
        self._requested_at: float | None = None
        self._tries = 0
        self._next_is_segment = False
        """The node has announced the value, and sends it in a segment at the next request."""

    @property
    def finished(self) -> bool:
        return not self._remaining or bool(self.problem)

    def next_request(self, now: float) -> CanFrame | None:
        """Returns the SDO request for the next object dictionary entry.

        Returns ``None`` while an SDO response is awaited, and after the comparison has finished.
        """
        if self._next_is_segment and self._requested_at is None:
            self._requested_at = now
            return CanFrame(self.request, sdo.upload_segment_request(0))
        waiting = self._requested_at is not None and now - self._requested_at < ANSWER_TIME
        if self.finished or waiting:
            return None
        expected = self._remaining[-1]
        if self._tries >= TRIES:
            self.problem = f"no response to the SDO upload of {_label(expected)}"
            return None
        self._tries += 1
        self._requested_at = now
        self._next_is_segment = False
        return CanFrame(self.request, sdo.upload_request(expected.index, expected.subindex))

    def take_response(self, data: bytes) -> None:
        """Compares the value in an SDO response with the expected value.

        An SDO response for an object that was not requested is ignored.
        """
        if self.finished or self._requested_at is None or len(data) < 8:
            return
        expected = self._remaining[-1]
        abort_code = sdo.abort_code(data)
        is_segment = self._next_is_segment and abort_code is None
        object_key = struct.unpack_from("<HB", data, 1)
        if not is_segment and object_key != (expected.index, expected.subindex):
            return
        if abort_code is not None:
            self.problem = f"{_label(expected)} cannot be read: {sdo.abort_text(abort_code)}"
            return
        if not is_segment and not sdo.is_expedited(data):
            self._next_is_segment, self._requested_at = True, None
            return
        content = sdo.segment_data(data) if is_segment else data[4:8]
        value = sdo.decode_number(expected.type, content)
        if (expected.index, expected.subindex) == SERIAL_NUMBER:
            self.serial = value
        if value != expected.value:
            self.problem = f"{_label(expected)} is {value}, but must be {expected.value}"
            return
        self._remaining.pop()
        self._requested_at, self._tries, self._next_is_segment = None, 0, False


class SupervisedNode(NamedTuple):
    """A node whose objects are read again and again.

    ``request`` and ``response``: COB-IDs of the SDO requests and SDO responses.
    """

    name: str
    request: int
    response: int
    objects: tuple[ObjectValue, ...]


class ObjectSupervision:
    """Reads the required objects of all nodes of a bus again and again, one in each control cycle.

    A drive whose watchdog was changed or switched off after the start-up would not stop if the base
    driver fails.  A node that restarted without a boot-up message, a tool at another interface of
    the node, or another program on the bus can cause such a change.  ``required_objects`` states
    the time in which all objects are read.  The bus load contains one SDO exchange for each control
    cycle.
    """

    def __init__(self, nodes: Sequence[SupervisedNode]) -> None:
        self.problem: Fault | None = None
        """First mismatch."""
        self._nodes = [node for node in nodes if node.objects]
        self._index = -1
        self._readback: ObjectReadback | None = None

    def next_request(self, now: float) -> CanFrame | None:
        """Returns the SDO request of the control cycle at ``now`` (s), or ``None``."""
        if not self._nodes or self.problem:
            return None
        readback = self._readback
        if readback is None or readback.finished:
            self._index = (self._index + 1) % len(self._nodes)
            node = self._nodes[self._index]
            readback = ObjectReadback(node.request, node.response, node.objects)
            self._readback = readback
        request = readback.next_request(now)
        self._take_problem()
        return request

    def take_response(self, node: str, data: bytes) -> None:
        """Compares an SDO response of ``node``, if its response is awaited."""
        if self._readback is not None and self._nodes[self._index].name == node:
            self._readback.take_response(data)
            self._take_problem()

    def _take_problem(self) -> None:
        if self._readback is not None and self._readback.problem:
            self.problem = Fault(Cause.OTHER, self._readback.problem, self._nodes[self._index].name)


def _label(entry: ObjectValue) -> str:
    return f"{entry.name} ({entry.index:#06x}:{entry.subindex})"
