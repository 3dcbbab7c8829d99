"""Receives and sends all CAN frames of one bus in the control cycle."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

from thorvaldc.can import canopen
from thorvaldc.can.frame import CanFrame, CanInterface, ErrorState
from thorvaldc.model import Bus, FrameDefinition, Node, Robot
from thorvaldc.model.bus import MASTER, key_text
from thorvaldc.model.bus_identity import Heard
from thorvaldc.model.stopping import watchdog_time, yaw_per_metre
from thorvaldc.runtime.can_base import (
    battery_and_io_drivers,
    frame_receiver,
    motor_controller,
    node_watchdog,
)
from thorvaldc.runtime.can_base.base_fault import Cause, Fault
from thorvaldc.runtime.can_base.foreign_frame_relay import Relay

OCCASIONAL_AT_REST, OCCASIONAL_DRIVING = 8, 1
"""Largest number of occasional frames in a cycle: at rest, and while the robot drives."""
RELAYED_PER_CYCLE: Final = 4
"""Largest number of frames in a cycle that are relayed to foreign devices."""
REPORT_KINDS: Final = ("pdo", "broadcast")
"""Kinds of frames in which nodes report measurements."""
DEVICE_TIMEOUT: Final = 1.0
"""Time (s) without a report after which a warning names the IO board."""
SEND_FAILURES: Final = 3
"""Number of incomplete cycles in a row after which the robot stops."""
LONGEST_DELAY: Final = 0.5
"""Longest time (s) for which the process of a simulated bus may run late."""
EXTRA_RESPONSES: Final = 2.0
"""Largest number of SDO responses without request."""
_ROUNDING: Final = 1e-6
"""Tolerance (s) for the rounding of times."""


class BusConnection:
    """One CAN bus with the drivers of its nodes.

    Only the thread of the control loop may call the methods of a ``BusConnection``.

    - ``send_until``: time (s) after which the frames of the present cycle are too old to be sent;
    - ``starved``: ``True`` if only NMT commands are sent, so that nothing feeds the watchdogs of
      the nodes, see ``stop_ladder``;
    - ``outbox``: frames that are sent once, when a cycle has room for the frame;
    - ``not_sent``: number of frames that the CAN interface did not accept, ``not_sent_before``:
      until the last complete cycle;
    - ``malformed``: number of received frames that were too short, or had a number that is not
      finite.
    """

    def __init__(self, robot: Robot, bus: Bus, interface: CanInterface, *, threaded: bool) -> None:
        """Creates a driver for each node on the CAN bus.

        If ``threaded`` is ``True``, CAN frames are received in a separate thread, if the CAN
        interface needs one for the times of reception.  Raises
        ``DiagnosticError`` (``bus-driver-unknown``) if a motor controller or a battery has no
        driver.
        """
        self.robot = robot
        self.bus = bus
        self.interface = interface
        self.controllers: list[motor_controller.MotorController] = []
        self.batteries: list[battery_and_io_drivers.BatteryDriver] = []
        self.boards: list[battery_and_io_drivers.IoBoardDriver] = []
        for node in bus.nodes:
            self._add_driver(node)
        self.relay = Relay(bus)
        self.readbacks: dict[str, node_watchdog.ObjectReadback] = {}
        """Comparison of the objects of a node with the robot file, by name of the node."""
        self.supervision = node_watchdog.ObjectSupervision(())
        """Repeated reading of the required objects of the motor controllers."""
        self._unanswered: dict[str, int] = {}
        """Number of SDO requests without response by name of the node."""
        self._extra_responses: dict[str, float] = {}
        """Number of SDO responses without request by name of the node; see ``_count_request``."""
        self.foreign_master = ""
        """Description of a frame of another master on the bus; empty if there is none."""
        self.outbox: deque[CanFrame] = deque()
        self.send_until = math.inf
        self.starved = False
        self.not_sent = self.not_sent_before = 0
        self.malformed = 0
        self.failures_in_a_row = 0
        self._next_controller = 0
        by_producer = {(f.producer, f.kind): f for f in bus.frames}
        self._sync = by_producer.get((MASTER, "sync"))
        self._heartbeat = by_producer.get((MASTER, "heartbeat"))
        self._heartbeat_due = -math.inf
        by_name = {c.node.name: c for c in self.controllers}
        self._emergency_frames = {
            f.key: by_name[f.producer]
            for f in bus.frames
            if f.kind == "emcy" and f.producer in by_name
        }
        self._sdo = {
            node: (frames[0].cob_id, frames[1].cob_id)
            for node in by_name
            if len(frames := _sdo_frames(bus, node)) == 2
        }
        self._sdo_requests = {request: node for node, (request, _) in self._sdo.items()}
        self._sdo_responses = {response: node for node, (_, response) in self._sdo.items()}
        self._handlers = [
            *(pair for controller in self.controllers for pair in controller.handlers.items()),
            *(pair for battery in self.batteries for pair in battery.handlers.items()),
            *(pair for board in self.boards for pair in board.handlers.items()),
        ]
        self._handled: dict[int, int] = {}
        devices = [*(c.node for c in self.controllers), *(board.node for board in self.boards)]
        self._reports = {
            node.name: [
                codec
                for codec in motor_controller.node_codecs(bus, node).values()
                if codec.frame.producer == node.name
                and codec.frame.kind in REPORT_KINDS
                # A frame whose content alternates is a slow report of constants.
                and not any(signal.multiplexer for signal in codec.frame.signals)
            ]
            for node in devices
        }
        # Only a master sends NMT, SYNC, the heartbeat of the master, commands and SDO requests.  If
        # such a frame is received, another master is on the bus.
        self._master_names = _master_frames(bus)
        self._unknown_ids = _ids_of_unknown_nodes(bus)
        self.unknown_node: int | None = None
        """Id of a CANopen node on the bus that the robot file does not have, or ``None``."""
        event_keys = {
            *self._master_names,
            *self._unknown_ids,
            *self.relay.from_device,
            *self._emergency_frames,
            *self._sdo_responses,
            *(f.key for f in bus.frames if f.kind == "heartbeat" and f.producer in by_name),
        }
        # Frames of other buses tell that two buses are exchanged.
        extended = {f.key for each in robot.buses for f in each.frames if f.extended}
        self.receiver = frame_receiver.FrameReceiver(interface, event_keys, extended)
        self.watchdog = node_watchdog.NodeWatchdog(bus, self.controllers, self.receiver.latest)
        periods = {n: t for c in self.controllers for n, t in c.shortest_periods().items()}
        names = [*by_name, *self._device_names()]
        self.rates = frame_receiver.FrameRates(bus, names, self.receiver.latest, periods)
        if threaded and not interface.receives_by_itself:
            self.receiver.start()

    def _add_driver(self, node: Node) -> None:
        has_motors = any(channel.actuator is not None for channel in node.channels)
        if has_motors:
            self.controllers.append(
                motor_controller.controller_class(node)(self.robot, self.bus, node)
            )
        elif node.protocol == "thorvald_io":
            self.boards.append(battery_and_io_drivers.IoBoardDriver(self.bus, node))
        elif battery := battery_and_io_drivers.battery_driver(self.robot, self.bus, node):
            self.batteries.append(battery)

    # -- receiving ---------------------------------------------------------------------------------

    def receive(self, now: float) -> None:
        """Decodes all CAN frames that were received since the last control cycle.

        Heartbeats, EMCY messages and other events are decoded first, in the order of their
        reception.  Of each periodic report only the newest CAN frame is decoded.
        """
        received_until = self.interface.received_until
        events = self.receiver.drain()
        self.watchdog.begin_cycle(now, received_until, self.receiver.drained_until)
        for event in events:
            self._handle_event(event)
        self.rates.take_sample()
        latest, handled = self.receiver.latest, self._handled
        for key, handler in self._handlers:
            frame = latest.get(key)
            if frame is None or handled.get(key) == frame.number:
                continue
            handled[key] = frame.number
            try:
                handler(frame.data, frame.time)
                self.watchdog.malformed_since.pop(key, None)
            except ValueError:
                self.malformed += 1
                self.watchdog.malformed_since.setdefault(key, frame.time)

    def _handle_event(self, event: frame_receiver.Event) -> None:
        time, key, data = event
        if key in self.watchdog.heartbeat_frames:
            self.watchdog.take_heartbeat(key, data, time)
        elif key in self._emergency_frames:
            if len(data) >= 2:
                self._emergency_frames[key].error_code = canopen.Emergency.unpack(data).error_code
        elif key in self._sdo_responses:
            self._take_sdo_response(self._sdo_responses[key], data)
        elif key in self.relay.from_device:
            self.relay.take(key, data, time)
        elif key in self._master_names:
            name = self._master_names[key]
            self.foreign_master = f"another master is on the bus: it sends {name} ({key_text(key)})"
        elif key in self._unknown_ids:
            self.unknown_node = key & 0x7F

    def _take_sdo_response(self, name: str, data: bytes) -> None:
        readback = self.readbacks.get(name)
        if readback is None:
            return
        if self._unanswered.get(name, 0) > 0:
            self._unanswered[name] -= 1
        else:
            self._extra_responses[name] = self._extra_responses.get(name, 0.0) + 1.0
        readback.take_response(data)
        self.supervision.take_response(name, data)

    def heard(self) -> Heard:
        serials = (readback.serial for readback in self.readbacks.values())
        return Heard(self.receiver.latest.keys(), [s for s in serials if s is not None])

    def clear_counts(self, boot_ups: int) -> None:
        """Forgets the frames that were counted before, and allows ``boot_ups`` further boot-up
        messages of each node."""
        self.rates.clear()
        self.receiver.ignored_id = self.unknown_node = None
        self.watchdog.allow_boot_ups(boot_ups)
        self._extra_responses.clear()

    def impostor(self) -> Fault | None:
        """Returns the fault if another master, or a second device with the id of a motor
        controller, is on the bus, else ``None``."""
        if self.foreign_master:
            return Fault(Cause.MASTER, self.foreign_master)
        if not (self.rates.excessive or self._extra_responses or self.watchdog.has_boot_ups):
            return None
        if self.rates.missed_time:
            return Fault(
                Cause.GAP,
                f"the nodes on the bus `{self.bus.name}` have sent the frames of "
                f"{self.rates.missed_time:.2f} s more than the clock of the computer shows; did it "
                "sleep, or do all frames arrive twice?",
            )
        for controller in self.controllers:
            name = controller.node.name
            if self._extra_responses.get(name, 0.0) > EXTRA_RESPONSES:
                second = frame_receiver.second_device(controller.node.id)
                cob_id = self._sdo[name][1]
                reason = f"more SDO responses ({cob_id:#05x}) than requests; {second}"
                return Fault(Cause.SECOND, reason, name)
            problem = self.rates.excessive.get(name) or self.watchdog.boot_up_problem(controller)
            if problem:
                return Fault(Cause.SECOND, problem, name)
        return None

    def forget_suspicious_devices(self) -> bool:
        """Forgets the devices that only warn and keep the robot disarmed; returns whether there
        were any.

        The counts of the motor controllers stay: a program that resets again and again must not
        hide a second one.
        """
        noticed = self.rates.forget(self._device_names()) or self.receiver.ignored_id is not None
        self.receiver.ignored_id = None
        return noticed

    def suspicious_devices(self) -> list[str]:
        """Returns warnings about the devices of the bus.

        A battery or an IO board may exist twice, and a motor may turn without torque.  No CANopen
        device obeys an extended or remote frame with the id of a command, but a program of another
        kind is on the bus.
        """
        excessive, ignored = self.rates.excessive, self.receiver.ignored_id
        names = [name for name in self._device_names() if name in excessive]
        warnings = [f"{name}: {excessive[name]}" for name in names]
        warnings += [f"{c.node.name}: {c.warning}" for c in self.controllers if c.warning]
        bus = f"on the bus `{self.bus.name}`"
        if self.unknown_node is not None:
            warnings.append(f"a node {bus} has the id {self.unknown_node}, the robot file has none")
        if ignored is not None:
            ids = f"extended or remote frames with the id {ignored:#05x} are {bus}"
            warnings.append(f"{ids}; they command nothing, but which program sends them?")
        return warnings

    def _device_names(self) -> list[str]:
        return [b.node.name for b in self.batteries] + [b.node.name for b in self.boards]

    @property
    def is_lost(self) -> bool:
        """``True`` if no frame of the driver reaches the bus."""
        return bool(self.receiver.lost) or self.interface.state is ErrorState.BUS_OFF

    def problem(self, now: float) -> Fault | None:
        """Returns the first fault that must stop the robot, or ``None``."""
        bus = f"the bus `{self.bus.name}`"
        if self.receiver.lost:
            return Fault(Cause.BUS, f"the CAN interface of {bus} is lost: {self.receiver.lost}")
        if self.interface.state is ErrorState.BUS_OFF:
            return Fault(Cause.BUS, f"the CAN controller of {bus} is off the bus (bus-off)")
        delay = now - self.interface.received_until
        cannot_send = self.failures_in_a_row >= SEND_FAILURES
        if delay > LONGEST_DELAY or (cannot_send and delay > SEND_FAILURES * self.bus.sync_period):
            late = f"the simulation of {bus} runs {delay * 1000:.0f} ms late"
            return Fault(Cause.GAP, f"{late}; is the computer too busy?")
        if self.supervision.problem:
            return self.supervision.problem
        if cannot_send and self.not_sent == self.not_sent_before:
            late = f"{SEND_FAILURES} control cycles in a row lasted too long"
            return Fault(Cause.GAP, f"{late}; is the computer or {bus} too busy?")
        if cannot_send:
            return Fault(Cause.BUS, f"frames cannot be sent on {bus}; is any node connected?")
        problems = (self.watchdog.problem(controller, now) for controller in self.controllers)
        return next(filter(None, problems), None)

    def reported(self, name: str, now: float) -> dict[str, float]:
        """Returns the newest reported values of a motor controller or an IO board.

        ``name``: name of the node.  The keys are the names of the signals in the robot file, always
        the same and in the same order, without those of a frame with a multiplexer.  A value is in
        the unit of its signal, or NaN if it is older than two periods and ``DEVICE_TIMEOUT``.
        """
        values: dict[str, float] = {}
        for codec in self._reports[name]:
            frame, period = self.receiver.latest.get(codec.key), codec.frame.period
            known = dict.fromkeys(codec.names, math.nan)
            oldest = max(DEVICE_TIMEOUT, 2.0 * (math.inf if period is None else period))
            if frame is not None and now - frame.time <= oldest:
                with contextlib.suppress(ValueError):  # it is malformed, which is counted elsewhere
                    known = codec.decode_named(frame.data)
            values.update(known)
        return values

    def silent_devices(self, now: float) -> list[str]:
        """Returns the names of IO boards that have stopped sending reports.

        A silent IO board causes a warning, but does not stop the robot.  Silent batteries are
        judged by ``BatterySupervision``.
        """
        return [b.node.name for b in self.boards if now - b.time > DEVICE_TIMEOUT]

    # -- sending -----------------------------------------------------------------------------------

    def queue_nmt(
        self,
        command: canopen.NmtCommand,
        controllers: Sequence[motor_controller.MotorController] | None = None,
    ) -> None:
        """Queues an NMT command for each CANopen motor controller in ``controllers``.

        If ``controllers`` is ``None``, the command is queued for all motor controllers.

        The NMT command is not broadcast, because foreign devices on the bus may belong to another
        master.
        """
        for controller in controllers if controllers is not None else self.controllers:
            if controller.node.is_canopen:
                self.outbox.append(
                    CanFrame(canopen.NMT, canopen.nmt_message(command, controller.node.id))
                )

    def queue_setting(
        self, controller: motor_controller.MotorController, name: str, value: float
    ) -> None:
        """Queues the frame that changes a setting of a motor controller.

        Raises ``ValueError`` if the motor controller has no setting ``name`` or does not accept the
        value.
        """
        self.outbox.append(controller.setting_frame(name, value))
        self.rates.change_periods(controller.shortest_periods())

    def start_readback(self) -> None:
        """Starts the comparison of the object dictionaries of all motor controllers with the robot
        file."""
        self.readbacks = {
            c.node.name: node_watchdog.ObjectReadback(*self._sdo[c.node.name], c.expected_objects())
            for c in self.controllers
            if c.node.name in self._sdo
        }
        self._unanswered.clear()
        self._extra_responses.clear()
        self.supervision = node_watchdog.ObjectSupervision(
            [
                node_watchdog.SupervisedNode(
                    c.node.name, *self._sdo[c.node.name], tuple(c.expected_objects())
                )
                for c in self.controllers
                if c.node.name in self._sdo
            ]
        )

    def cyclic_frames(self, intent: motor_controller.Intent, now: float) -> list[CanFrame]:
        """Returns the motor command frames of a control cycle in the order of their
        arbitration.

        Raises ``ValueError`` if a target speed or a target angle is not finite.
        """
        frames = [
            frame for c in self.controllers for frame in c.cyclic_frames(c.intent_of(intent), now)
        ]
        return sorted(frames, key=lambda frame: frame.arbitration)

    def occasional_frames(
        self, intent: motor_controller.Intent, now: float, commands: bool, driving: bool
    ) -> Iterator[CanFrame]:
        """Yields the CAN frames of this control cycle that are not sent in every cycle.

        NMT commands and other queued CAN frames are sent first.  After the queued CAN frames, SDO
        requests are sent, and then occasional frames and queries of the motor controllers in turn.
        At most ``OCCASIONAL_DRIVING`` CAN frames are yielded if ``driving`` is ``True``, else at
        most ``OCCASIONAL_AT_REST`` CAN frames, and one SDO request of the supervision.  If
        ``commands`` is ``False``, no occasional frames of the motor controllers are yielded, only
        their queries.
        """
        room = OCCASIONAL_DRIVING if driving else OCCASIONAL_AT_REST
        while room > 0 and self.outbox:
            room -= 1
            yield self.outbox.popleft()
        # A response may be on its way through a simulated bus whose process is late.
        received_until = min(now, self.interface.received_until)
        for name, readback in self.readbacks.items():
            request = readback.next_request(received_until) if room > 0 else None
            if request is not None:
                room -= 1
                self._count_request(name)
                yield request
        if commands:
            request = self.supervision.next_request(received_until)
            if request is not None:
                self._count_request(self._sdo_requests[request.id])
                yield request
        count = len(self.controllers)
        for i in range(count):
            if room <= 0:
                break
            controller = self.controllers[(self._next_controller + i) % count]
            own_intent = controller.intent_of(intent)
            frame = controller.occasional_frame(own_intent, now) if commands else None
            if frame is None:
                frame = controller.query_frame(now)
            if frame is not None:
                room -= 1
                self._next_controller = (self._next_controller + i + 1) % count
                yield frame

    def _count_request(self, name: str) -> None:
        """Counts an SDO request to a node.

        A single repeated response, which errors on the bus can cause, is forgotten after four
        requests.
        """
        self._unanswered[name] = self._unanswered.get(name, 0) + 1
        if name in self._extra_responses:
            self._extra_responses[name] = max(self._extra_responses[name] - 0.25, 0.0)

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        """Puts a CAN frame into the send queue of the CAN interface.

        Waits at most ``timeout`` seconds while the send queue is full.  Returns ``True`` if the CAN
        frame was put into the send queue.
        """
        queued = False
        if not self.receiver.lost:
            try:
                queued = self.interface.send(frame, timeout)
            except ConnectionError as error:
                self.receiver.lost = str(error) or "the interface is lost"
        if queued:
            self.receiver.count_sent(frame)
        self.not_sent += not queued
        return queued

    @property
    def overdue(self) -> bool:
        """``True`` if the frames of the present control cycle are too old to be sent."""
        return self.interface.now > self.send_until

    def send_nmt(self) -> None:
        """Sends the queued NMT commands, and drops all other queued frames."""
        while self.outbox:
            frame = self.outbox.popleft()
            if frame.id == canopen.NMT:
                self.send(frame)

    def send_sync(self, timeout: float = 0.0) -> bool:
        return self._sync is None or self.send(CanFrame(self._sync.cob_id), timeout)

    def send_relayed(self) -> None:
        for _ in range(RELAYED_PER_CYCLE):
            frame = None if self.overdue else self.relay.next_outgoing()
            if frame is None:
                return
            self.relay.count_sent(frame, self.send(frame))

    def send_heartbeat(self, now: float, operational: bool) -> None:
        """Sends the CANopen heartbeat of the master if the heartbeat period has passed.

        The heartbeat reports the NMT state operational if ``operational`` is ``True``, else
        pre-operational.
        """
        frame = self._heartbeat
        if frame is None or now < self._heartbeat_due - _ROUNDING:
            return
        period = frame.period or 0.1
        # The heartbeat period starts at `now` for the first heartbeat and after missed heartbeats.
        # Missed heartbeats of the master are not sent later.
        restart = now - self._heartbeat_due > period / 2.0
        self._heartbeat_due = (now if restart else self._heartbeat_due) + period
        state = canopen.NmtState.OPERATIONAL if operational else canopen.NmtState.PRE_OPERATIONAL
        self.send(CanFrame(frame.cob_id, bytes([state])))

    @property
    def counters(self) -> dict[str, int]:
        """Numbers of frames that were received, dropped, malformed and not sent, by name."""
        return {
            "received": self.receiver.received,
            "dropped": self.receiver.dropped,
            "malformed": self.malformed,
            "not_sent": self.not_sent,
        }

    def close(self) -> None:
        self.receiver.stop()
        self.interface.close()


def _master_frames(bus: Bus) -> dict[int, str]:
    """Returns a description of each frame that only the master may send, by key.

    NMT, SYNC and LSS belong to the master only on a bus with CANopen nodes.  Frames that the base
    driver relays to foreign devices are excluded: a foreign device may have a master of its own.
    """
    names: dict[int, str] = {}
    if any(node.is_canopen for node in bus.nodes):
        names = {canopen.NMT: "NMT", canopen.SYNC: "SYNC"}
        # An LSS request can give all drives one id, which shows at their next start only.
        names[canopen.LSS_REQUEST] = "LSS requests, which change node ids"
    for frame in bus.frames:
        if frame.producer != MASTER:
            continue
        if frame.kind == "heartbeat":
            names[frame.key] = "a heartbeat"
        elif frame.kind == "sdo":
            names[frame.key] = f"SDO requests to {', '.join(frame.consumers)}"
        elif frame.kind == "pdo":
            names[frame.key] = f"commands to {', '.join(frame.consumers)}"
    return names


def _ids_of_unknown_nodes(bus: Bus) -> frozenset[int]:
    """Returns the COB-IDs of EMCY messages and heartbeats that belong to no node of the bus."""
    if not any(node.is_canopen for node in bus.nodes):
        return frozenset()
    ids = {base + i for base in (canopen.EMCY, canopen.HEARTBEAT) for i in range(1, 128)}
    return frozenset(ids - {frame.key for frame in bus.frames})


def _sdo_frames(bus: Bus, node: str) -> list[FrameDefinition]:
    """Returns the frame definitions of the SDO requests and the SDO responses of a node."""
    sdo_frames = [f for f in bus.frames if f.kind == "sdo"]
    frames = [f for f in sdo_frames if node == f.producer or node in f.consumers]
    return sorted(frames, key=lambda f: f.producer != MASTER)


# -- stop of all wheels together after the loss of a bus ----------------------------------------
#
# The drives of a lost bus receive nothing.  They run on at their speed v until their watchdogs act,
# after the time W, and then brake with the deceleration a.  If the wheels of the other side braked
# at once, the robot would turn by about v W / track: by 22 deg at 0.8 m/s, out of its crop row:
#
#     speed  v ____________                     ____________
#              |\          \                                \
#              | \          \  lost side                      \  both sides
#            0 |__\__________\___               ______________\___
#              0   other side  W + v / a         0            W + v / a
#
# The other wheels therefore keep their speed for the time W, and then brake, too.  The robot needs
# no more time and room than the wheels of the lost bus need anyway, which is what it promises for a
# dead driver.  Other reactions turn or delay it more: a ramp that ends at the same time turns the
# robot by half of the angle, and one that ends after the same path takes longer.
#
# It is done only where the driver knows that the bus is lost: its interface is gone or off the bus.
# A silent bus may be one whose drives have lost their power and brake; then all other wheels brake
# at once.  So they do if the lost wheels are on both sides, because then the robot does not turn.


def hold_time(connections: Sequence[BusConnection]) -> float:
    """Returns the time (s) for which the wheels of the remaining buses keep their speed.

    Returns 0 if the wheels have to brake at once: no bus is lost, or all are, or the robot does not
    turn, or the drives of the lost bus have no watchdog and never stop.
    """
    lost = [connection for connection in connections if connection.is_lost]
    if not lost or len(lost) == len(connections):
        return 0.0
    watchdogs = [watchdog_time(c.node) for connection in lost for c in connection.controllers]
    times = [time for time in watchdogs if time is not None]
    turns = yaw_per_metre(lost[0].robot, [connection.bus for connection in lost]) > 0.0
    return max(times, default=0.0) if turns and len(times) == len(watchdogs) else 0.0
