"""One bus of the robot as its master sees it: who is there, how they are, what is sent."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.interface import CanInterface
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.bus import Bus, FrameDefinition, Node
from thorvaldc.model.robot import Robot
from thorvaldc.runtime.can_base.battery_and_io_drivers import (
    BatteryDriver,
    IoBoardDriver,
    battery_driver,
)
from thorvaldc.runtime.can_base.foreign_frame_relay import Relay
from thorvaldc.runtime.can_base.frame_receiver import Receiver
from thorvaldc.runtime.can_base.motor_controller import (
    MASTER,
    Intent,
    Message,
    MotorController,
    controller_class,
)
from thorvaldc.runtime.can_base.object_readback import ObjectCheck

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
START, PRE_OPERATION, RESET_NODE = 0x01, 0x80, 0x81
NMT_COB_ID = 0x000
MISS, MISSES = 1.5, 2
"""Periods after which a report is missed, and misses in a row that are a fault."""
BLIND = 2
"""Late cycles in a row in which nobody is said to be silent: what has come was not taken yet."""
HEARTBEATS = 3.0
"""Periods of silence after which a node is lost."""
AT_REST, DRIVING = 8, 1
"""Frames on demand in a cycle: while the robot does not drive, and while it does."""
RELAYED = 4
"""Frames passed on to foreign devices in a cycle, at most."""
SILENT = 1.0
"""s without a report after which a battery or an IO board is said to be silent."""
SEND_FAILURES = 3
"""Cycles in a row in which not all was sent, from which on it is a fault."""

_STATES = {BOOT_UP: "boot-up", STOPPED: "stopped", PRE_OPERATIONAL: "pre-operational"}


class Heartbeat(NamedTuple):
    """The newest heartbeat of a node: when it came (s), and the NMT state in it."""

    time: float
    state: int


class _Watched(NamedTuple):
    cob_id: int
    name: str
    period: float


class BusLink:
    """The master's end of a bus.  Only the thread of the loop uses it.

    ``failed`` counts frames that the port did not take, ``malformed`` those received that
    were too short.
    """

    def __init__(self, robot: Robot, bus: Bus, port: CanInterface, *, threaded: bool) -> None:
        """Raises ``DiagnosticError`` for a motor controller that no driver knows."""
        self.robot = robot
        self.bus = bus
        self.port = port
        self.controllers: list[MotorController] = []
        self.batteries: list[BatteryDriver] = []
        self.boards: list[IoBoardDriver] = []
        self.relay = Relay(bus)
        for node in bus.nodes:
            self._add(node)
        by_producer = {(f.producer, f.kind): f for f in bus.frames}
        self._sync = by_producer.get((MASTER, "sync"))
        self._heartbeat = by_producer.get((MASTER, "heartbeat"))
        self._heartbeat_due = -math.inf
        self.heartbeats: dict[str, Heartbeat] = {}
        self.problems: dict[str, str] = {}
        """What nodes have said of themselves since it was cleared: they restarted, say."""
        self.foreign_master = ""
        self.outbox: deque[Message] = deque()
        self.failed = 0
        self.malformed = 0
        self.failures_in_a_row = 0
        self.checks: dict[str, ObjectCheck] = {}
        self._watched_from = math.inf
        self._taken_at = math.inf
        self._late = 0
        self._turn = 0
        own = {c.node.name: c for c in self.controllers}
        self._heartbeat_frames = {
            f.cob_id: f for f in bus.frames if f.kind == "heartbeat" and f.producer in own
        }
        self._emergency_frames = {
            f.cob_id: own[f.producer] for f in bus.frames if f.kind == "emcy" and f.producer in own
        }
        self._watched = {c.node.name: tuple(_watched(bus, c.node)) for c in self.controllers}
        self._sdo = {
            node: (frames[0].cob_id, frames[1].cob_id)
            for node in own
            if len(frames := _sdo_frames(bus, node)) == 2
        }
        self._answers = {response: node for node, (_, response) in self._sdo.items()}
        self._master_ids = {f.cob_id for f in bus.frames if f.producer == MASTER}
        self._handlers = [
            *(pair for c in self.controllers for pair in c.handlers.items()),
            *(pair for b in self.batteries for pair in b.handlers.items()),
            *(pair for b in self.boards for pair in b.handlers.items()),
        ]
        self._seen: dict[int, int] = {}
        # What a second master would send; a node's own frames never have these identifiers.
        commands = {NMT_COB_ID, 0x080, 0x700 + bus.master_id}
        relays = {*self.relay.from_device, *self.relay.to_device}
        self._foreign = {
            f.cob_id: f for f in bus.frames if f.producer == MASTER and f.cob_id in commands
        }
        events = {
            *commands,
            *relays,
            *self._heartbeat_frames,
            *self._emergency_frames,
            *self._answers,
        }
        self.receiver = Receiver(port, events)
        if threaded:
            self.receiver.start()

    def _add(self, node: Node) -> None:
        wired = any(channel.actuator is not None for channel in node.channels)
        if wired:
            self.controllers.append(controller_class(node)(self.robot, self.bus, node))
        elif node.protocol == "thorvald_io":
            self.boards.append(IoBoardDriver(self.bus, node))
        elif (battery := battery_driver(self.bus, node)) is not None:
            self.batteries.append(battery)

    # -- what comes --------------------------------------------------------------------------------

    def take(self, now: float) -> None:
        """Drain and decode: events in their order, then the newest of every report."""
        late = now - self._taken_at > MISS * self.bus.sync_period
        self._late = self._late + 1 if late else 0
        self._taken_at = now
        for time, cob_id, data in self.receiver.drain():
            self._event(time, cob_id, data)
        latest, seen = self.receiver.latest, self._seen
        for cob_id, handle in self._handlers:
            found = latest.get(cob_id)
            if found is None or seen.get(cob_id) == found.number:
                continue
            seen[cob_id] = found.number
            try:
                handle(found.data, found.time)
            except ValueError:
                self.malformed += 1

    def _event(self, time: float, cob_id: int, data: bytes) -> None:
        if cob_id in self._heartbeat_frames:
            if data:
                self._beat(self._heartbeat_frames[cob_id], time, data[0] & 0x7F)
        elif cob_id in self._emergency_frames:
            if len(data) >= 2:
                self._emergency_frames[cob_id].error_code = struct.unpack_from("<H", data)[0]
        elif cob_id in self._answers:
            check = self.checks.get(self._answers[cob_id])
            if check is not None:
                check.take(data)
        elif cob_id in self.relay.from_device:
            self.relay.take(cob_id, data, time)
        elif cob_id in self._foreign or cob_id in (NMT_COB_ID, 0x080):
            what = {NMT_COB_ID: "NMT", 0x080: "SYNC"}.get(cob_id, "a heartbeat")
            self.foreign_master = f"another master is on the bus: it sends {what} ({cob_id:#05x})"

    def _beat(self, frame: FrameDefinition, time: float, state: int) -> None:
        name = frame.producer
        if state == BOOT_UP:
            controller = next(c for c in self.controllers if c.node.name == name)
            controller.restarted()
            self.problems[name] = "it has restarted"
        self.heartbeats[name] = Heartbeat(time, state)

    # -- how they are ------------------------------------------------------------------------------

    def watch(self, now: float) -> None:
        """From now on reports and heartbeats must come."""
        self._watched_from = now
        self.problems.clear()

    def unwatch(self) -> None:
        self._watched_from = math.inf

    @property
    def silent(self) -> list[str]:
        """Controllers that have not been heard at all."""
        return [
            c.node.name
            for c in self.controllers
            if self._beats(c.node) is not None and c.node.name not in self.heartbeats
        ]

    def problem(self, now: float) -> str:
        """The first thing that is wrong; empty: nothing is."""
        if self.receiver.lost:
            return f"the interface to the bus `{self.bus.name}` is gone: {self.receiver.lost}"
        if self.port.state is ErrorState.BUS_OFF:
            return f"the controller of the bus `{self.bus.name}` is off (bus-off)"
        if self.foreign_master:
            return self.foreign_master
        if self.failures_in_a_row >= SEND_FAILURES:
            return f"nothing can be sent on the bus `{self.bus.name}`; is anybody there?"
        for controller in self.controllers:
            name = controller.node.name
            wrong = self.problems.get(name) or controller.problem or self._overdue(controller, now)
            if wrong:
                return f"{name}: {wrong}"
        return ""

    def _overdue(self, controller: MotorController, now: float) -> str:
        name = controller.node.name
        since = self._watched_from
        if since == math.inf or 0 < self._late <= BLIND:
            return ""
        frame = self._beats(controller.node)
        if frame is not None and frame.period is not None:
            limit = HEARTBEATS * frame.period
            if controller.node.heartbeat_timeout is not None:
                limit = min(limit, controller.node.heartbeat_timeout)
            beat = self.heartbeats.get(name, Heartbeat(-math.inf, BOOT_UP))
            age = now - max(beat.time, since)
            if age > limit:
                return f"no heartbeat for {age * 1000:.0f} ms"
            if beat.state != OPERATIONAL and beat.time > since:
                return f"it is {_STATES.get(beat.state, beat.state)}, not operational"
        latest = self.receiver.latest
        for watched in self._watched[name]:
            found = latest.get(watched.cob_id)
            age = now - max(since, -math.inf if found is None else found.time)
            # Missed once after 1.5 periods, again a period later.
            if age / watched.period > MISS + MISSES - 1:
                return f"no {watched.name} for {age * 1000:.0f} ms"
        return ""

    def heard(self, controller: MotorController) -> bool:
        """Whether each report that comes by itself has come at least once since the start."""
        return all(w.cob_id in self.receiver.latest for w in self._watched[controller.node.name])

    def in_state(self, controller: MotorController, state: int, since: float) -> bool:
        """Whether its newest heartbeat after ``since`` tells that NMT state."""
        if self._beats(controller.node) is None:
            return True
        beat = self.heartbeats.get(controller.node.name)
        return beat is not None and beat.state == state and beat.time > since

    def stale(self, now: float) -> list[str]:
        """Batteries and IO boards that are silent: a warning, they drive nothing."""
        times = [(b.node.name, b.state.time) for b in self.batteries]
        times += [(b.node.name, b.time) for b in self.boards]
        return [name for name, time in times if now - time > SILENT]

    def _beats(self, node: Node) -> FrameDefinition | None:
        found = (f for f in self._heartbeat_frames.values() if f.producer == node.name)
        return next(found, None)

    # -- what is sent ------------------------------------------------------------------------------

    def nmt(self, command: int, controllers: list[MotorController] | None = None) -> None:
        """Tell the robot's own controllers, one by one: foreign devices have another master."""
        for controller in controllers if controllers is not None else self.controllers:
            self.outbox.append(Message(NMT_COB_ID, bytes([command, controller.node.id])))

    def check(self) -> None:
        """Begin to compare the controllers' objects with the robot's file."""
        self.checks = {
            c.node.name: ObjectCheck(*self._sdo[c.node.name], c.objects())
            for c in self.controllers
            if c.node.name in self._sdo
        }

    def cyclic(self, intent: Intent, now: float) -> list[Message]:
        """The commands of a cycle, in the order of their identifiers.  Raises ``ValueError``."""
        return sorted(m for c in self.controllers for m in c.cyclic(intent, now))

    def sporadic(
        self, intent: Intent, now: float, commands: bool, driving: bool
    ) -> Iterator[Message]:
        """What there is to tell once, at most so many frames as have room in a cycle.

        ``commands``: also what controllers are to be told.
        """
        room = DRIVING if driving else AT_REST
        while room > 0 and self.outbox:
            room -= 1
            yield self.outbox.popleft()
        for check in self.checks.values():
            asked = check.ask(now) if room > 0 else None
            if asked is not None:
                room -= 1
                yield asked
        n = len(self.controllers)
        for i in range(n):
            if room <= 0 or not commands:
                break
            controller = self.controllers[(self._turn + i) % n]
            told = controller.sporadic(intent, now)
            if told is not None:
                room -= 1
                self._turn = (self._turn + i + 1) % n
                yield told

    def send(self, message: Message, timeout: float = 0.0) -> bool:
        taken = False
        if not self.receiver.lost:
            try:
                taken = self.port.send(CanFrame(message.cob_id, message.data), timeout)
            except ConnectionError as fault:
                self.receiver.lost = str(fault) or "the interface is gone"
        self.failed += not taken
        return taken

    def send_sync(self, timeout: float = 0.0) -> bool:
        return self._sync is None or self.send(Message(self._sync.cob_id, b""), timeout)

    def send_relayed(self) -> None:
        for _ in range(RELAYED):
            frame = self.relay.to_send()
            if frame is None:
                return
            self.relay.sent(frame, self.send(Message(frame.id, frame.data)))

    def send_heartbeat(self, now: float, operational: bool) -> None:
        """The master's own sign of life, when it is due."""
        frame = self._heartbeat
        if frame is None or now < self._heartbeat_due - 1e-6:
            return
        period = frame.period or 0.1
        late = now - self._heartbeat_due > period / 2.0  # also the first
        self._heartbeat_due = (now if late else self._heartbeat_due) + period
        state = OPERATIONAL if operational else PRE_OPERATIONAL
        self.send(Message(frame.cob_id, bytes([state])))

    def close(self) -> None:
        self.receiver.stop()
        self.port.close()


def _watched(bus: Bus, node: Node) -> Iterator[_Watched]:
    for frame in bus.frames:
        if frame.producer == node.name and frame.kind == "pdo" and frame.period is not None:
            name = frame.name.removeprefix(f"{node.name}_")
            yield _Watched(frame.cob_id, name, frame.period)


def _sdo_frames(bus: Bus, node: str) -> list[FrameDefinition]:
    """Request and response."""
    own = [f for f in bus.frames if f.kind == "sdo" and node in (f.producer, *f.consumers)]
    return sorted(own, key=lambda f: f.producer != MASTER)


def unconnected(robot: Robot) -> DiagnosticError | None:
    """A motor of the base that nothing on a bus moves."""
    joints = {w.spin_joint for w in robot.wheels if w.driven}
    joints |= {w.steering_joint for w in robot.wheels if w.steering_joint is not None}
    nodes = {
        channel.actuator: node.name
        for bus in robot.buses
        for node in bus.nodes
        for channel in node.channels
    }
    for actuator in robot.actuators:
        if actuator.joint in joints and actuator.name not in nodes:
            return DiagnosticError(
                "bus-motor-unconnected",
                f"the motor {actuator.name} has no controller on a bus",
                actuator.span,
                hint="give it a channel of a controller",
            )
    return None
