"""Reads and commands the joints of a robot base over CAN.

The control cycle lasts 20 ms, which is the period of the SYNC message.  CAN frames of one control
cycle on the bus:

    0 ms                                                                              20 ms
    |-----------------------------------------------------------------------------------|
    driver   RPDO 201, 202, 203, ...  SYNC  occasional  relayed  heartbeat 77F (100 ms)
    nodes                                   TPDO 181, 182, 183, ...   heartbeats 701, ...
    |
    read     all frames since the last cycle are decoded; the state machine is updated
    (driver) ramps and calculator turn the twist into joint commands
    write    the frames are sent

The base driver sends the motor commands in the order of their CAN identifiers, which is also the
order of the bus arbitration.  The SYNC frame is sent after the last motor command of the control
cycle.  CiA 402 drives apply all motor commands when they receive SYNC, and send their reports after
SYNC.  Roboteq controllers apply each motor command on arrival, and send their reports with a period
of their own.  The base driver sends the heartbeat of the master only after a control cycle in which
all CAN frames were sent.

A process that was stopped in the middle of a cycle sends at most one frame of that cycle when it
goes on.  The other frames of the cycle are dropped when the next cycle is due, because their
commands are old.

The control loop sends all CAN frames; no CAN frame is sent by a timer.  The heartbeat of the master
stops if the control loop hangs or if the CAN frames of a cycle cannot be sent.  Each motor
controller has a watchdog that stops the motors if the heartbeat of the master is missing.  The
control loop also falls silent on a bus with a motor that does not obey (``stop_ladder``).  The
watchdog of a CiA 402 drive is the heartbeat consumer (object 0x1016).  The script on a Roboteq
controller stops the motors 0.5 s after the last motor command with a new sequence number.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final

from thorvaldc.can.canopen import NmtCommand
from thorvaldc.can.frame import CanFrame, CanInterface
from thorvaldc.diagnostics import CODES, Code, DiagnosticError
from thorvaldc.diagnostics.files import finite
from thorvaldc.model import Robot
from thorvaldc.model.settings import AT_START
from thorvaldc.model.stopping import REPORT_TIMEOUT
from thorvaldc.runtime import base_interface
from thorvaldc.runtime.can_base import base_state_machine, battery_and_io_drivers
from thorvaldc.runtime.can_base.base_fault import Cause, Fault
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.bus_services import (
    BusServices,
    arming_reasons,
    bus_services,
    component_statuses,
    measured_load,
)
from thorvaldc.runtime.can_base.motor_controller import Intent
from thorvaldc.runtime.motion_supervision import Axis, Deviation
from thorvaldc.runtime.mypyc_marks import mypyc_attr
from thorvaldc.runtime.service_table import Service

SEND_TIME: Final = 0.25
"""Longest waiting time of one frame for room in the send queue, as a share of the cycle."""


@mypyc_attr(allow_interpreted_subclasses=True)
class CanBase(base_interface.BaseHandle):
    """A robot base whose joints are measured and commanded over CAN.

    The method ``read`` decodes the received CAN frames, and the method ``write`` sends the CAN
    frames of a control cycle.  The state machine of the base decides whether the motors follow the
    commands.  The stop of the base by software is not a safety function.
    """

    def __init__(
        self,
        robot: Robot,
        interfaces: Mapping[str, CanInterface],
        *,
        threaded: bool = True,
        times: base_state_machine.Times | None = None,
    ) -> None:
        """Creates the drivers of all nodes on the buses of ``robot``.

        - ``interfaces``: CAN interface of each bus, by name of the bus; all interfaces must use the
          same clock;
        - ``threaded``: ``True`` if a separate thread receives from each CAN interface, which is not
          possible in virtual time;
        - ``times``: time limits of the state machine.

        Raises ``DiagnosticError`` if the robot has no bus (``bus-missing``), if a motor of the base
        is not connected to a bus (``bus-motor-unconnected``), or if a motor controller has no
        driver (``bus-driver-unknown``).
        """
        robot.require_bus()
        _require_connected_motors(robot)
        self.robot = robot
        self._period = min(bus.sync_period for bus in robot.buses)
        self.connections: list[BusConnection] = []
        try:
            for bus in robot.buses:
                self.connections.append(
                    BusConnection(robot, bus, interfaces[bus.name], threaded=threaded)
                )
        except DiagnosticError:
            for connection in self.connections:
                connection.receiver.stop()
            raise
        homes_at_start = robot.driver.homing == AT_START
        self.state_machine = base_state_machine.BaseStateMachine(
            robot, self.connections, times, homes_at_start=homes_at_start
        )
        self.state_machine.changed = self._note_change
        self.changes: list[base_state_machine.StateChange] = []
        """Changes of the state since the start of the run."""
        batteries = [battery for c in self.connections for battery in c.batteries]
        self.battery_supervision = battery_and_io_drivers.BatterySupervision(
            robot.driver.battery, batteries, robot.common_source
        )
        self._battery_level = battery_and_io_drivers.BatteryLevel.OK
        self.nodes = BusServices(self.connections, lambda: self.standing)
        self.cycles = 0
        """Number of control cycles whose frames were all sent."""
        self.incomplete = 0
        """Number of control cycles with a frame that was not sent."""
        self._axes = [axis for c in self.state_machine.controllers for axis in c.axes]
        self._wheels = len(robot.wheels)
        self._turning = False
        self._send_timeout = SEND_TIME * self._period
        self.starves_drives = False
        """``True`` while no command and no heartbeat is sent, but SYNC, so that the watchdogs of
        the drives act and their reports go on."""

    @property
    def period(self) -> float:
        """Duration (s) of a control cycle."""
        return self._period

    @property
    def hold_reason(self) -> str:
        state_machine = self.state_machine
        if state_machine.state in (
            base_state_machine.BaseState.FAULT,
            base_state_machine.BaseState.ESTOP,
        ):
            return f"{state_machine.state.value}: {state_machine.reason}"
        if state_machine.ending:
            return "the driver is shutting down"
        if state_machine.state is base_state_machine.BaseState.STANDBY:
            return "not homed; arming homes the steering"
        if not state_machine.state.drives:
            return str(state_machine.state.value)
        return ""

    @property
    def state(self) -> base_state_machine.BaseState:
        return self.state_machine.state

    @property
    def fault_code(self) -> Code | None:
        """Diagnostic code of the state FAULT or ESTOP, ``None`` in other states."""
        state_machine = self.state_machine
        if state_machine.state not in (
            base_state_machine.BaseState.FAULT,
            base_state_machine.BaseState.ESTOP,
        ):
            return None
        if state_machine.mismatch:
            return CODES["bus-mismatch"]
        return CODES["bus-stopped" if state_machine.was_started else "bus-start"]

    @property
    def standing(self) -> bool:
        """``True`` if no wheel turns and no wheel is commanded to turn."""
        return not self._turning and all(c.standing for c in self.state_machine.controllers)

    def read(self, now: float) -> base_interface.JointStates:
        """Decodes the received CAN frames and returns the measured positions and velocities of the
        joints.

        The position and the velocity of a joint are NaN if the newest report of the motor is too
        old.  The time of the joint states is the mean measurement time of all motors.
        """
        for connection in self.connections:
            connection.receive(now)
        self.state_machine.update(now)
        n = self._wheels
        speeds, angles, rates = [0.0] * n, [0.0] * n, [0.0] * n
        oldest = now - REPORT_TIMEOUT * self._period
        total = 0.0
        for axis in self._axes:
            valid = axis.time >= oldest
            total += axis.time if valid else now
            if axis.steering:
                angles[axis.wheel] = axis.position if valid else math.nan
                rates[axis.wheel] = axis.velocity if valid else math.nan
            else:
                speeds[axis.wheel] = axis.velocity if valid else math.nan
        return base_interface.JointStates(total / max(len(self._axes), 1), speeds, angles, rates)

    def write(self, commands: base_interface.JointCommands, now: float) -> None:
        state_machine = self.state_machine
        follows = state_machine.state.drives and not state_machine.ending
        if follows and not self._set_targets(commands):
            state_machine.fail("a command is not a finite number")
            state_machine.update(now)
        intent = state_machine.intent
        self._turning = intent is Intent.FOLLOW and any(
            axis.target for axis in self._axes if not axis.steering
        )
        if not state_machine.may_send:
            return
        for connection in self.connections:
            connection.send_until = now + self._period
        if self.starves_drives:
            for connection in self.connections:
                connection.send_sync(self._send_timeout)
            return
        sent = {c.bus.name: self._send_on(c, intent, now) for c in self.connections}
        complete = all(sent.values())
        for connection in self.connections:
            # Without heartbeats, the watchdogs of the other drives would act before the time.
            beats = complete or (sent[connection.bus.name] and state_machine.holds_speed)
            if beats and not connection.starved and not connection.overdue:
                connection.send_heartbeat(now, state_machine.operational)
        if complete:
            self.cycles += 1
        else:
            self.incomplete += 1

    def close(self) -> None:
        """Closes the CAN interfaces."""
        for connection in self.connections:
            connection.close()

    # -- what a robot on its buses can do ----------------------------------------------------------

    @property
    def lost(self) -> str:
        lost = [c.bus.name for c in self.connections if c.receiver.lost]
        return f"the bus {' and '.join(lost)} is lost" if lost else ""

    @property
    def speed_share(self) -> float:
        return self.battery_supervision.speed_share

    @property
    def disarming_reason(self) -> str:
        if self._battery_level is battery_and_io_drivers.BatteryLevel.STOP:
            return self.battery_supervision.reason
        return ""

    @property
    def is_homed(self) -> bool:
        return self.state_machine.state is not base_state_machine.BaseState.STANDBY

    @property
    def is_homing(self) -> bool:
        return self.state_machine.state is base_state_machine.BaseState.HOMING

    @property
    def ended(self) -> bool:
        return self.state_machine.ended

    @property
    def gaps_are_faults(self) -> bool:
        state_machine = self.state_machine
        return (state_machine.state.drives or self.is_homing) and not state_machine.ending

    @property
    def longest_stop(self) -> float:
        return self.state_machine.times.stop

    def arming_reasons(self, now: float) -> Iterator[str]:
        return arming_reasons(self.state_machine, self.battery_supervision, now)

    def home(self, now: float, *, again: bool = False) -> str:
        return self.state_machine.home(now, again)

    def cancel_homing(self, now: float) -> None:
        self.state_machine.cancel_homing(now)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """All motors of the base."""
        return tuple(self._axes)

    def power_only(self, axes: Collection[Axis], now: float) -> str:
        """Allows torque for these motors only, for the first motion of a new robot.

        The base then homes and enables these motors, as at the start; the other motors lose their
        torque at once.  Returns the reason if this is refused: a motor controller with several
        motors cannot power a single one.
        """
        for controller in self.state_machine.controllers:
            powered = [axis in axes for axis in controller.axes]
            if any(powered) and not all(powered) and not controller.powers_single_motors:
                return f"the driver of {controller.node.name} cannot power a single motor"
        for axis in self._axes:
            axis.powered = axis in axes
        return self.state_machine.home(now, again=False)

    def safety_stop(self, engaged: bool) -> None:
        self.state_machine.safety_stop(engaged)

    def reset(self, now: float, commanded: bool) -> str:
        return self.state_machine.reset(now, commanded)

    def fail(self, reason: str) -> None:
        self.state_machine.fail(reason, Cause.GAP)

    def disobeyed(self, deviations: Sequence[Deviation], now: float) -> None:
        for controller in self.state_machine.controllers:
            texts = [text for axis, text in deviations if axis in controller.axes]
            if texts:
                fault = Fault(Cause.MOTION, ", ".join(texts), controller.node.name)
                self.state_machine.disobeyed(fault, now)

    def note_cycle(self, now: float, *, stale: bool) -> None:
        self._battery_level = self.battery_supervision.update(now)
        self.state_machine.note_motion(now, not self.standing, stale)

    def end(self) -> None:
        self.state_machine.end()

    def leave(self) -> None:
        if not self.state_machine.may_send:
            return
        for connection in self.connections:
            connection.outbox.clear()
            connection.queue_nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
            while connection.outbox:
                connection.send(connection.outbox.popleft(), self._period)

    def batteries(self) -> dict[str, battery_and_io_drivers.BatteryState]:
        return {b.node.name: b.state for c in self.connections for b in c.batteries}

    def supply(self) -> battery_and_io_drivers.BatteryState | None:
        return self.battery_supervision.supply

    def motor_controller_data(self, now: float) -> dict[str, dict[str, float]]:
        return {
            controller.node.name: connection.reported(controller.node.name, now)
            for connection in self.connections
            for controller in connection.controllers
        }

    def io_data(self, now: float) -> dict[str, dict[str, float]]:
        return {
            board.node.name: connection.reported(board.node.name, now)
            for connection in self.connections
            for board in connection.boards
        }

    def warnings(self, now: float) -> list[str]:
        warnings = self.battery_supervision.warnings()
        for connection in self.connections:
            warnings += [f"{name}: no reports" for name in connection.silent_devices(now)]
            warnings += connection.suspicious_devices()
        return warnings

    def values(self) -> dict[str, Any]:
        """``supervisor`` is the state of the base, ``fault`` the reason of FAULT or ESTOP."""
        return {
            "supervisor": self.state_machine.state.value,
            "fault": self.state_machine.reason,
            "fault_code": code.number if (code := self.fault_code) is not None else "",
            "batteries": {name: finite(b.source) for name, b in self.batteries().items()},
            "supply": None if (supply := self.supply()) is None else finite(supply.source),
            "outputs": {board.node.name: dict(board.outputs) for board in self.nodes.boards},
            "bus_load": {c.bus.name: measured_load(c) for c in self.connections},
            "not_relayed": self.nodes.relay_drops(),
        }

    def component_statuses(self, now: float) -> Iterator[base_interface.ComponentStatus]:
        return component_statuses(self.state_machine, self.battery_supervision, self.changes, now)

    def send_to_device(self, frame: CanFrame, now: float) -> str:
        """A frame that no bus knows is refused by the last bus, which counts it."""
        for connection in self.connections:
            if frame.key in connection.relay.to_device or connection is self.connections[-1]:
                return connection.relay.offer(frame, now)
        return ""

    def frames_from_devices(self) -> Iterator[CanFrame]:
        for connection in self.connections:
            yield from (relayed.frame for relayed in connection.relay.received())

    def services(self) -> list[Service]:
        return list(bus_services(self.nodes))

    def _note_change(self, now: float, state: base_state_machine.BaseState, reason: str) -> None:
        self.changes.append(base_state_machine.StateChange(now, state, reason))

    # -- inside --------------------------------------------------------------------------------

    def _set_targets(self, commands: base_interface.JointCommands) -> bool:
        """Sets the target wheel speeds and target steering angles of all motors.

        Returns ``False`` and keeps all previous targets if a joint command is not a finite number.
        """
        targets = [
            (commands.angles if axis.steering else commands.speeds)[axis.wheel]
            for axis in self._axes
        ]
        if not all(map(math.isfinite, targets)):
            return False
        for axis, target in zip(self._axes, targets, strict=True):
            axis.target = target
        return True

    def _send_on(self, connection: BusConnection, intent: Intent, now: float) -> bool:
        """Sends what a bus gets in this cycle; a bus that is starved gets NMT commands only."""
        if connection.starved:
            connection.send_nmt()
            return True
        return self._send_cycle(connection, intent, now)

    def _send_cycle(self, connection: BusConnection, intent: Intent, now: float) -> bool:
        """Sends the CAN frames of a control cycle on one bus.

        Returns ``True`` if all CAN frames were sent.
        """
        state_machine = self.state_machine
        complete = True
        if state_machine.operational:
            try:
                commands = (
                    connection.cyclic_frames(intent, now) if state_machine.may_command else []
                )
            except ValueError as error:
                state_machine.fail(str(error))
                return False
            # Commands that stop the motors are never too old.  A script that receives the first of
            # two frames alone would resume the old speed of its second motor.
            expires = intent in (Intent.FOLLOW, Intent.HOME)
            for frame in commands:
                late = expires and connection.overdue
                if late or not connection.send(frame, self._send_timeout):
                    complete = False
                    break
            # The SYNC frame is not sent if a motor command could not be sent, so that the drives do
            # not apply an incomplete set of commands.
            complete = complete and not (expires and connection.overdue)
            complete = complete and connection.send_sync(self._send_timeout)
        driving = state_machine.state.drives
        occasional = connection.occasional_frames(intent, now, state_machine.may_command, driving)
        while not connection.overdue and (request := next(occasional, None)) is not None:
            complete = connection.send(request, self._send_timeout) and complete
        connection.send_relayed()
        complete = complete and not connection.overdue
        connection.failures_in_a_row = 0 if complete else connection.failures_in_a_row + 1
        if complete:
            connection.not_sent_before = connection.not_sent
        return complete


def _require_connected_motors(robot: Robot) -> None:
    """Raises ``DiagnosticError`` if a motor of the base is not connected to a node on a bus."""
    joints = {w.spin_joint for w in robot.wheels if w.driven}
    joints |= {w.steering_joint for w in robot.wheels if w.steering_joint is not None}
    connected = {
        channel.actuator for bus in robot.buses for node in bus.nodes for channel in node.channels
    }
    for actuator in robot.actuators:
        if actuator.joint in joints and actuator.name not in connected:
            raise DiagnosticError(
                "bus-motor-unconnected",
                f"the motor {actuator.name} has no controller on a bus",
                actuator.span,
                hint="connect it to a channel of a controller",
            )
