"""Reads and commands the joints of a robot base over CAN.

The control cycle lasts 20 ms (the sync period).  The diagram shows one control cycle on the bus:

    0 ms                                                                              20 ms
    |-----------------------------------------------------------------------------------|
    driver   RPDO 201, 202, 203, ...  SYNC  occasional  relayed  heartbeat 77F (100 ms)
    nodes                                   TPDO 181, 182, 183, ...   heartbeats 701, ...
    |
    read     all frames since the last cycle are decoded; the state machine is updated
    (driver) ramps and calculator turn the twist into joint commands
    write    the frames are sent

The driver sends the commands in the order of their identifiers, which is also the order of the bus
arbitration.  SYNC follows the last command.  CiA 402 drives apply all commands together at SYNC,
and send their reports after SYNC.  The Roboteq script applies each command on arrival, and sends
its reports with its own period.  The driver sends the heartbeat of the master only after a complete
cycle.

No frame is sent by a timer.  If the control loop hangs or a cycle cannot be sent, the heartbeat of
the master is missing.  Without the heartbeat of the master each node stops its motors with its own
watchdog.  The watchdog of a CiA 402 drive is the heartbeat consumer (object 0x1016).  The Roboteq
script stops the motors 0.5 s after the last new sequence number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from thorvaldc.can.interface import CanInterface
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.require_bus import require_bus
from thorvaldc.model.robot import Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.can_base.base_state_machine import BaseStateMachine, Times
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.motor_controller import Intent
from thorvaldc.runtime.can_base.node_watchdog import REPORT_TIMEOUT

SEND_TIME = 0.25
"""Longest waiting time of one frame for room in the send queue, as a share of the cycle."""


class CanBase(BaseHandle):
    """A robot base whose joints are measured and commanded over CAN.

    ``read`` decodes the received frames, and ``write`` sends the frames of a cycle.  The state
    machine of the base decides whether the motors follow the commands.  A software stop is not a
    safety function.
    """

    def __init__(
        self,
        robot: Robot,
        interfaces: Mapping[str, CanInterface],
        *,
        threaded: bool = True,
        times: Times | None = None,
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
        require_bus(robot)
        _require_connected_motors(robot)
        self.robot = robot
        self.period = min(bus.sync_period for bus in robot.buses)
        """Duration (s) of a control cycle."""
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
        self.state_machine = BaseStateMachine(self.connections, times)
        self.armed = False
        """``True`` if the base may follow commands; see ``arm``."""
        self.cycles = 0
        """Number of control cycles whose frames were all sent."""
        self.incomplete = 0
        """Number of control cycles with a frame that was not sent."""
        self._axes = [axis for c in self.state_machine.controllers for axis in c.axes]
        self._wheels = len(robot.wheels)
        self._turning = False
        self._send_timeout = SEND_TIME * self.period

    @property
    def hold_reason(self) -> str:
        state_machine = self.state_machine
        if state_machine.state in (BaseState.FAULT, BaseState.ESTOP):
            return f"{state_machine.state.value}: {state_machine.reason}"
        if state_machine.ending:
            return "the driver is shutting down"
        if not state_machine.state.drives:
            return str(state_machine.state.value)
        return "" if self.armed else "a motion was commanded before the base was ready"

    @property
    def standing(self) -> bool:
        """``True`` if no wheel turns and no wheel is commanded to turn."""
        return not self._turning and all(c.standing for c in self.state_machine.controllers)

    def read(self, now: float) -> JointStates:
        """Decodes the received frames and returns the measured joint states.

        The value of a joint is NaN if the newest report of its motor is too old.  The time of the
        joint states is the mean measurement time of all motors.
        """
        for connection in self.connections:
            connection.receive(now)
        self.state_machine.update(now)
        if not self.state_machine.state.drives:
            self.armed = False
        n = self._wheels
        speeds, angles, rates = [0.0] * n, [0.0] * n, [0.0] * n
        oldest = now - REPORT_TIMEOUT * self.period
        total = 0.0
        for axis in self._axes:
            valid = axis.time >= oldest
            total += axis.time if valid else now
            if axis.steering:
                angles[axis.wheel] = axis.position if valid else math.nan
                rates[axis.wheel] = axis.velocity if valid else math.nan
            else:
                speeds[axis.wheel] = axis.velocity if valid else math.nan
        return JointStates(total / max(len(self._axes), 1), speeds, angles, rates)

    def arm(self, commanded: bool) -> None:
        """Allows motion if the base is ready and no motion is commanded (``commanded`` ``False``).

        A joystick that is deflected during the start-up cannot move the robot.
        """
        if self.state_machine.state.drives and not commanded:
            self.armed = True

    def write(self, commands: JointCommands, now: float) -> None:
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
        complete = True
        for connection in self.connections:
            complete = self._send_cycle(connection, intent, now) and complete
        if complete:
            self.cycles += 1
            for connection in self.connections:
                connection.send_heartbeat(now, state_machine.operational)
        else:
            self.incomplete += 1

    def close(self) -> None:
        """Closes the CAN interfaces."""
        for connection in self.connections:
            connection.close()

    # -- inside --------------------------------------------------------------------------------

    def _set_targets(self, commands: JointCommands) -> bool:
        """Sets the target values of all motors.

        Returns ``False`` and changes no target if a command is not a finite number.
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

    def _send_cycle(self, connection: BusConnection, intent: Intent, now: float) -> bool:
        """Sends the frames of a cycle on one bus and returns ``True`` if all frames were sent."""
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
            for frame in commands:
                if not connection.send(frame, self._send_timeout):
                    complete = False
                    break
            # SYNC is omitted if a command is missing, so that no drive applies an incomplete set of
            # commands.
            complete = complete and connection.send_sync(self._send_timeout)
        driving = state_machine.state.drives
        for frame in connection.occasional_frames(intent, now, state_machine.may_command, driving):
            complete = connection.send(frame, self._send_timeout) and complete
        connection.send_relayed()
        connection.failures_in_a_row = 0 if complete else connection.failures_in_a_row + 1
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
