r"""Drives one motor of a robot at a time, whose wheels are off the ground.

A ``MotorSession`` is a ``DrivenRobot`` like any other: arming, stop locks, gaps in time, faults and
the end of the program are those of every run.  Only the meaning of the twist differs.  The driver
commands a twist, ramps it up, and ramps it down when the session falls silent.  The reached share
of the twist is the share of the test speed of the powered motor::

    twist    0 ___/^^^^^^^^^^^\___ 0        silence: the driver ramps to rest
    share    0 ___/     1     \___ 0
    wheel    test speed * share             steering: the target angle moves with this speed

All other motors have no torque (``CanBase.power_only``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from typing import TypeVar

from thorvaldc.can.canopen import NmtCommand
from thorvaldc.can.frame import CanInterface
from thorvaldc.model import Robot, TwistInput
from thorvaldc.model.settings import REQUIRED
from thorvaldc.runtime.base_interface import CheckedJointStates, JointCommands, RequestRefused
from thorvaldc.runtime.can_base.base_fault import Fault
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.can_base.motor_controller import MotorController
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.motion_supervision import STANDING, Axis
from thorvaldc.runtime.pace import end_signals
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.tools.commission.questions import joint_text
from thorvaldc.tools.commission.uncommanded_motion import UncommandedMotion

T = TypeVar("T")
Steps = Generator[None, None, T]
"""Part of a check, which goes on for one control cycle with each ``next``, and returns a value."""

SOURCE = "commission"
"""Name of the twist source of a session."""
TWIST_SHARE = 0.3
"""Twist of a session as a share of the limits of the robot; more makes the ramps longer."""
START_TIME = 20.0
"""Longest time (s) until the base is ready, or until the robot can be armed."""
OFF_TIME = 3.0
"""Longest time (s) until the motor controllers report that motors at rest have no torque."""
RESET_DELAY = 0.5
"""Time (s) after a fault until it is reset, in which the motors come to rest."""


class Interrupted(Exception):
    """A check cannot go on for a reason that is not the motion of its motor; ends the session."""


class SingleMotorBase(CanBase):
    """The CAN base of a robot of which one motor is driven.

    - ``share``: share of the test speed (0 to 1) that the twist of the driver has reached;
    - ``travel``: commanded travel (rad) of the joint since ``begin``.
    """

    def __init__(
        self, robot: Robot, interfaces: Mapping[str, CanInterface], *, threaded: bool
    ) -> None:
        super().__init__(robot, interfaces, threaded=threaded)
        # After a homing, the session turns the steering straight itself, slowly.
        self.state_machine.straightens = False
        n = len(robot.wheels)
        self._ideal = JointCommands([0.0] * n, [0.0] * n)
        self._driven: Axis | None = None
        self._velocity = 0.0
        self._start = 0.0
        self._limit = math.inf
        self._written_at = math.nan
        self.share = 0.0
        self.travel = 0.0

    def begin(self, axis: Axis, velocity: float, limit: float = math.inf) -> None:
        """Begins a motion from the present angle with the test speed ``velocity`` (rad/s).

        ``limit``: largest travel (rad), at which a steering joint stops.
        """
        self._driven, self._velocity, self.travel = axis, velocity, 0.0
        self._limit = limit
        self._start = axis.position if axis.steering else 0.0
        self._written_at = math.nan

    def end_motion(self) -> None:
        self._driven = None

    def commands(self, axis: Axis) -> bool:
        """Checks whether a motor may turn: it is driven, or it has torque to turn a steering."""
        if not self.state.drives or not axis.powered:
            return axis.powered and self.is_homing
        return axis.steering or (axis is self._driven and self.speed != 0.0)

    @property
    def speed(self) -> float:
        """Commanded speed (rad/s) of the joint."""
        return self._velocity * self.share if abs(self.travel) < self._limit else 0.0

    def read(self, now: float) -> CheckedJointStates:
        """Reads the buses, and returns joints that follow the driver exactly.

        The motion of one motor tells nothing about the twist of the robot.
        """
        time, ideal = super().read(now).time, self._ideal
        return CheckedJointStates(time, ideal.speeds, ideal.angles, [0.0] * len(ideal.speeds))

    def write(self, commands: JointCommands, now: float) -> None:
        self._ideal = commands
        n = len(commands.speeds)
        speeds, angles = [0.0] * n, [0.0] * n
        for each in self.axes:
            if each.steering:  # it stays where the base holds it
                angles[each.wheel] = each.target
        axis = self._driven
        if axis is not None:
            elapsed = now - self._written_at
            travel = self.travel + (self.speed * elapsed if 0.0 < elapsed < 1.0 else 0.0)
            self.travel = min(max(travel, -self._limit), self._limit)
            self._written_at = now
            if axis.steering:
                angles[axis.wheel] = self._start + self.travel
            else:
                speeds[axis.wheel] = self.speed
        super().write(JointCommands(speeds, angles), now)


class MotorSession:
    """Powers and drives one motor at a time; see the module.

    - ``base``, ``driven``: the base, and the robot that is driven;
    - ``by_hand``: motor whose wheel the operator turns by hand, or ``None``.

    If a motor turns that is not commanded, the script ends at once with ``Interrupted``.
    """

    def __init__(
        self,
        robot: Robot,
        interfaces: Mapping[str, CanInterface],
        *,
        threaded: bool = True,
    ) -> None:
        """The arguments and errors are those of ``RunSession``."""
        self.base = SingleMotorBase(robot, interfaces, threaded=threaded)
        clock = interfaces[robot.buses[0].name]
        self.driven = DrivenRobot(robot, self.base, clock, arming=REQUIRED)
        driver = self.driven.driver
        self.driven.multiplexer.add_source(
            TwistInput(SOURCE, "", 0, driver.settings.command_timeout)
        )
        speed = TWIST_SHARE * driver.settings.max_linear_velocity
        rate = TWIST_SHARE * driver.settings.max_angular_velocity
        choices = (Twist(speed, 0.0, 0.0), Twist(0.0, speed, 0.0), Twist(0.0, 0.0, rate))
        self.twist = next((t for t in choices if driver.limited(t) != ZERO_TWIST), choices[0])
        self.commands_motion = False
        """``True`` while the session commands its twist; otherwise it is silent."""
        self.by_hand: Axis | None = None
        self._motions = [UncommandedMotion(a, self.driven.period) for a in self.base.axes]
        self._script: Steps[None] | None = None
        self.driven.feed = self._feed
        self.base.power_only((), clock.now)

    @property
    def now(self) -> float:
        return self.driven.now

    def run(self, script: Steps[None], stop: Callable[[], bool] = lambda: False) -> bool:
        """Runs the control loop until ``script`` ends, and leaves the robot at rest without torque.

        Returns ``False`` if a signal of ``END_SIGNALS`` or ``stop()`` ended the loop before.
        """
        self._script = script
        with end_signals() as signalled:
            try:
                self.driven.run(stop=lambda: self._script is None or signalled() or stop())
                self.commands_motion = self.base.starves_drives = False
                self.driven.shutdown()
            except BaseException:
                # Without frames, the drives stop by their own time-outs.
                self.driven.close()
                raise
        return self._script is None

    @property
    def fault(self) -> str:
        """Reason of a fault or stop of the base, or an empty text."""
        state_machine = self.base.state_machine
        return state_machine.reason if state_machine.state in _STOPPED else ""

    @property
    def cause(self) -> Fault | None:
        """Cause of a fault or stop of the base."""
        return self.base.state_machine.fault

    # -- steps -------------------------------------------------------------------------------------

    def wait_until_ready(self) -> Steps[None]:
        """Waits until the base is ready.  Raises ``Interrupted`` for a fault."""
        since = self.now
        while self.base.state is not BaseState.READY:
            if self.fault:
                raise Interrupted(self.fault)
            if self.now - since > START_TIME:
                raise Interrupted(self._delay_text)
            yield

    def begin_power(self, axis: Axis) -> Steps[None]:
        """Allows torque for one motor; the base begins to home it if it has to be homed."""
        if refusal := self.base.power_only((axis,), self.now):
            raise Interrupted(refusal)
        yield

    def arm(self) -> Steps[None]:
        """Arms the robot, whose motion is the motion of the powered motor."""
        since, refusal = self.now, ""
        while not self.driven.armed:
            try:
                self.driven.arm()
            except RequestRefused as error:
                refusal = str(error)
            if self.fault or self.now - since > START_TIME:
                raise Interrupted(self.fault or refusal)
            yield

    def take_torque(self) -> None:
        """Takes the torque of all motors at once, and ends the motion."""
        self.commands_motion = False
        self.base.cancel_homing(self.now)
        for axis in self.base.axes:
            axis.powered = False
        self.driven.disarm()

    def release(self) -> Steps[None]:
        """Takes the torque of all motors, and resets a fault as an operator does."""
        self.take_torque()
        since = stands_since = self.now
        refusal = ""
        while True:
            yield
            if self.fault:
                try:
                    if self.now - since > RESET_DELAY:
                        self.driven.reset()
                except RequestRefused as error:
                    refusal = str(error)
            elif self.base.state is BaseState.STANDBY:
                self.base.power_only((), self.now)
            elif self.base.state is BaseState.READY and self._stands and self._is_off:
                break
            if self.base.state is not BaseState.READY or not self._stands:
                stands_since = self.now
            if self.now - stands_since > OFF_TIME:
                names = ", ".join(c.node.name for c in self._controllers if not c.is_off)
                raise Interrupted(f"cut the power: {names} reports torque, which nobody commands")
            if self.now - since > START_TIME:
                raise Interrupted(refusal or self.fault or self._delay_text)
        self.base.end_motion()

    @property
    def _controllers(self) -> list[MotorController]:
        return self.base.state_machine.controllers

    @property
    def _delay_text(self) -> str:
        return f"the base is {self.base.state.value} for {START_TIME:.0f} s"

    @property
    def _stands(self) -> bool:
        """``True`` if no motor reports motion; one without torque may roll on for a while."""
        return not any(abs(axis.velocity) > STANDING for axis in self.base.axes)

    @property
    def _is_off(self) -> bool:
        """``True`` if no motor has torque, as far as the motor controllers report it."""
        return all(controller.is_off for controller in self._controllers)

    # -- the control loop --------------------------------------------------------------------------

    def _feed(self, driver: BaseDriver, now: float) -> None:
        full, ramped = driver.limited(self.twist), driver.state.ramped
        size = max(full.speed, abs(full.wz))
        self.base.share = max(ramped.speed, abs(ramped.wz)) / size if size else 0.0
        if self._script is not None:
            try:
                next(self._script)
                self._check_other_motion(self._script, now)
            except StopIteration:
                self._script = None
        if self.commands_motion:
            # As every source, the session commands zero first.
            multiplexer = self.driven.multiplexer
            awaited = SOURCE in multiplexer.awaited_zeros(now)
            multiplexer.publish(SOURCE, ZERO_TWIST if awaited else self.twist, now)

    def _check_other_motion(self, script: Steps[None], now: float) -> None:
        """Ends the script if a motor turns that is not commanded; the shutdown then stops it.

        The ladder of the base does not stop a drive that reports no torque, because a robot on the
        ground may be pushed.  Here, the wheels are in the air: such a drive is started anew, after
        which it has no torque.
        """
        turning = [
            motion.axis
            for motion in self._motions
            if motion.update(now, self.base.commands(motion.axis) or motion.axis is self.by_hand)
        ]
        if not turning:
            return
        self.take_torque()
        texts = []
        for connection in self.base.connections:
            for controller in connection.controllers:
                axes = [axis for axis in controller.axes if axis in turning]
                texts += [self._motion_text(controller, axis) for axis in axes]
                climbs = self.base.state_machine.may_command and not controller.is_off
                if axes and not climbs:
                    connection.queue_nmt(NmtCommand.RESET_NODE, [controller])
        script.throw(Interrupted(f"cut the power: {'; '.join(texts)}"))

    def _motion_text(self, controller: MotorController, axis: Axis) -> str:
        joint = joint_text(self.driven.robot, axis.actuator)
        return (
            f"{joint} ({controller.node.name} {axis.channel}) reports {axis.velocity:.2f} rad/s,"
            " which nobody commands"
        )


_STOPPED = (BaseState.FAULT, BaseState.ESTOP)
