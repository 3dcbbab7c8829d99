"""The base driver: a control loop for a simulated or real base.

In each tick, the driver reads the joints, integrates the odometry, limits and ramps the commanded
twist, computes the joint commands, and writes the joint commands to the base.

A stop has one state, the last commands of the wheels (``BaseCalculator.stop``).  They shrink to
rest in every tick that does not drive, by the time since the last tick, whatever is measured.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.base_interface import BaseHandle, JointStates, ParameterError
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, TwistEstimate, for_robot
from thorvaldc.runtime.motion_supervision import Deviation, Follower
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.pace import Gap, TimeGapRule, gap_text
from thorvaldc.runtime.permission import MotionPermission, Rules
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST, Cov3, Pose2, Twist
from thorvaldc.runtime.twist_ramp import LastingDifference, Ramp, difference_text, is_axle_swing

MAX_TWIST: Final = 1e9
"""Twists with components (m/s, rad/s) whose absolute sum reaches this limit are rejected."""
STANDING_SPEED: Final = 0.05
"""Wheel speed (rad/s) below which a wheel stands."""
_TIME_TOLERANCE: Final = 1e-9
"""Tolerance (s) for rounding errors in the check of the command timeout."""


class DriveMode(enum.Enum):
    """Mode of the base driver.

    - ``IDLE``: no motion is commanded.
    - ``DRIVING``: the robot follows the commanded twist.
    - ``TIMED_OUT``: the last command is older than the command timeout.  The robot ramps its twist
      down to zero and stands.
    - ``WAITING``: no motion is accepted, because the base is disarmed, or because no zero twist
      was commanded since a gap in time.  The robot ramps its twist down to zero and stands.
    - ``FAULT``: the joint states are missing or invalid, or a gap in time was long.  The robot
      ramps its twist down to zero.
    - ``HELD``: the base does not follow joint commands and stops the robot itself.
    """

    IDLE = "idle"
    DRIVING = "driving"
    TIMED_OUT = "timed out"
    WAITING = "waiting"
    FAULT = "fault"
    HELD = "held"


@dataclass(slots=True)
class DriverState:
    """State of the base driver after a tick.

    - ``time``: time of the tick, s.
    - ``mode``: mode of the base driver.
    - ``commanded_twist``: twist of the active command.
    - ``ramped``: feasible part of the commanded twist, after the speed limits and the ramp.
    - ``infeasible``: part of the commanded twist that fixed wheels and steering limits do not
      allow.
    - ``command``: joint commands for ``ramped``, or ``None`` before the first tick.
    - ``joints``: last usable joint states, or ``None`` before the first measurement.
    - ``odometry``: estimated mean twist of the robot since the previous tick.
    - ``pose``: pose of ``base_link`` in the odometry frame.
    - ``pose_covariance``: covariance of ``pose``, expressed as a small motion in ``base_link``.
    - ``fault``: reason of the mode ``FAULT``, or empty in other modes.
    - ``hold_reason``: reason of the modes ``HELD`` and ``WAITING``, or empty in other modes.
    - ``not_followed``: twist that the robot drives instead of the commanded one, and the cause, if
      the difference lasts for longer than any ramp takes; else empty, see ``LastingDifference``.
    """

    time: float
    mode: DriveMode
    commanded_twist: Twist
    ramped: Twist
    infeasible: Twist
    command: BaseCommand | None
    joints: JointStates | None
    odometry: TwistEstimate
    pose: Pose2
    pose_covariance: Cov3
    fault: str = ""
    hold_reason: str = ""
    not_followed: str = ""


class BaseDriver:
    """Control loop of a robot's base: watchdog, limits, ramp, calculator and odometry.

    The caller calls ``tick(now)`` at ``rate`` Hz with a monotonic time.  The driver reads no other
    clock, so a simulation is repeatable.

    A gap in time between two control cycles voids the last command, see ``pace``.  After a
    short gap, a zero twist must be commanded before the robot moves.  After a long gap, ``reset``
    must be called too.  A time without usable joint states voids the command as a short gap does.
    """

    def __init__(
        self,
        robot: Robot,
        base: BaseHandle,
        calculator: BaseCalculator | None = None,
        settings: DriverSettings | None = None,
        parameters: str | None = None,
    ) -> None:
        """Creates a driver for ``robot``.

        ``parameters`` is the name of the initial parameter set.  If ``parameters`` is ``None``, the
        driver uses the ordinary values of the robot file.  Raises ``DiagnosticError`` if the
        parameter set is unknown or the calculator cannot drive the robot.
        """
        self.robot = robot
        self.base = base
        self.parameters = Parameters.from_robot(robot, parameters)
        if settings is not None:
            self.parameters = replace(self.parameters, settings=settings)
        self.calculator = calculator or for_robot(robot).with_parameters(
            self.parameters.radii, self.parameters.noise
        )
        self.calculator.decelerations = self.settings.decelerations
        self._staged: tuple[Parameters, BaseCalculator] | None = None
        self.speed_share = 1.0
        """Share (0 to 1) of the limits of the twist that the robot may use, for example less than 1
        while a battery is low.  At 0 the robot ramps to rest."""
        self.source_refusal = ""
        """Reason why the source that commands the twist moves nothing, or an empty text."""
        self._commanded_twist = ZERO_TWIST
        self._command_time = -math.inf
        self.commands = 0
        """Number of the accepted commands."""
        self.time_gaps = TimeGapRule.of(robot, self.settings, base.longest_interval)
        self.permission = MotionPermission.of(robot)
        geometry = self.calculator.geometry
        self._ramp = Ramp(self.settings, geometry.length, geometry.steering_time)
        self._follows = False
        """``True`` if the joints follow the commands: these begin at the measured angles."""
        self._may_have_braked = False
        """``True`` from a gap in time until joint states show how fast the wheels still turn."""
        self._seen_at = -math.inf
        """Time (s) of the last usable joint states; a gap in time voids the commands itself."""
        self._lasting_difference = LastingDifference(geometry)
        self.odometry = Odometry(self.calculator, self.settings.top_speeds)
        self._followers = [Follower(axis) for axis in base.axes]
        self.state = DriverState(
            -math.inf,
            DriveMode.IDLE,
            ZERO_TWIST,
            ZERO_TWIST,
            ZERO_TWIST,
            None,
            None,
            self.odometry.estimate,
            self.odometry.pose,
            self.odometry.covariance,
        )

    def __repr__(self) -> str:
        return f"<BaseDriver of {self.robot.name}: {self.state.mode.value}>"

    def command(self, twist: Twist, now: float) -> bool:
        """Commands ``twist`` from ``now`` on, for at most the command timeout.

        Returns ``False`` if the twist or the time is not finite or too large.  If a command is
        rejected, the previous command stays active until its timeout.
        """
        if not (float_sum(map(abs, twist)) < MAX_TWIST and math.isfinite(now)):
            return False
        self._commanded_twist = Twist(*twist)
        self._command_time = now
        self.commands += 1
        return True

    def commanded_twist(self, now: float) -> Twist:
        """Returns the twist of the command that is active at ``now``.

        The twist is zero if the command is older than the command timeout.
        """
        timed_out = now - self._command_time > self.settings.command_timeout + _TIME_TOLERANCE
        return ZERO_TWIST if timed_out else self._commanded_twist

    def gap_at(self, now: float) -> Gap:
        """Judges the time from the last control cycle until ``now`` (s).

        Before the first control cycle there is no gap.
        """
        last = self.state.time
        return self.time_gaps.judge(now - last, now) if math.isfinite(last) else Gap.NONE

    def void_commands(self, reason: str) -> None:
        """Voids the commands of all sources, and accepts no motion before a zero twist.

        ``reason``: reason that the operator sees, such as ``no control cycle for 120 ms``.
        """
        self._command_time = -math.inf
        self.permission.step(Rules.void, reason, self.state.time)

    def reset(self) -> None:
        """Resets the fault of a long gap in time.

        The robot moves again after a zero twist was commanded.
        """
        if self.permission.value.fault:
            self._command_time = -math.inf
            self.permission.step(Rules.reset, self.state.time)

    @property
    def settings(self) -> DriverSettings:
        """Settings of the driver in the active parameter set, such as limits and timeouts."""
        return self.parameters.settings

    def use(self, parameters: str | None) -> None:
        """Switches to a parameter set of the robot file.

        The name ``None`` selects the ordinary parameters of the robot file.

        The parameter change takes effect in the next tick, after the odometry update.  The odometry
        uses the previous wheel radii for the motion before the change, so the pose does not jump.
        Raises ``DiagnosticError`` if the parameter set is unknown.  The parameters are unchanged
        after an error.
        """
        self._stage(Parameters.from_robot(self.robot, parameters))

    def update(
        self,
        *,
        radii: Mapping[str, float] | None = None,
        noise: Mapping[str, float] | None = None,
        **limits: float,
    ) -> None:
        """Changes single parameters of the driver: wheel radii, noise or limits.

        - ``radii``: wheel radii (m) by wheel name.
        - ``noise``: standard deviations of the measurement errors by name, see ``Noise``.
        - ``limits``: limits in SI units by name, such as ``max_linear_velocity``.

        Parameters that are not named keep their values.  All parameter changes take effect together
        in the next tick, after the odometry update.  The parameters are unchanged after an error.

        Raises ``ParameterError`` if a name is unknown, if a value is outside of the range that the
        robot file allows, or if a radius is changed while the robot moves: the same twist would
        suddenly mean another speed of the wheels.
        """
        current = self._staged[0] if self._staged is not None else self.parameters
        changed = current.changed(self.robot, radii, noise, limits)
        if changed.radii != current.radii and not self.standing:
            raise ParameterError("the robot moves; its wheel radii can change only at rest")
        self._stage(changed)

    @property
    def standing(self) -> bool:
        """``True`` if no motion is commanded and no wheel was measured to turn."""
        joints = self.state.joints
        return self._ramp.twist == ZERO_TWIST and (
            joints is None or all(abs(speed) < STANDING_SPEED for speed in joints.speeds)
        )

    def _stage(self, parameters: Parameters) -> None:
        calculator = self.calculator.with_parameters(parameters.radii, parameters.noise)
        self._staged = (parameters, calculator)

    def _apply_staged_parameters(self) -> None:
        if self._staged is not None:
            self.parameters, calculator = self._staged
            self._staged = None
            calculator.resume(self.calculator)
            calculator.decelerations = self.settings.decelerations
            self.calculator = self.odometry.calculator = calculator
            self.odometry.top_speeds = self.settings.top_speeds
            self._ramp.settings = self.settings

    def reset_pose(self, pose: Pose2 = ORIGIN) -> None:
        """Sets the pose of the odometry and resets its covariance to zero."""
        self.odometry.reset(pose)
        self.state.pose = self.odometry.pose
        self.state.pose_covariance = self.odometry.covariance

    def tick(self, now: float, joints: JointStates | None = None) -> DriverState:
        """Runs one control cycle and returns the state of the driver.

        Returns the previous state if ``now`` has not advanced.  ``joints`` contains the joint
        states at ``now`` if the caller has already read them.

        A gap in time since the previous cycle stops the robot, see the class.

        The motion of the robot is unknown while joint states are unusable, and during an interval
        of more than ``LONGEST_INTERVAL`` without joint states.  While the motion is unknown, the
        pose does not change, and its covariance grows by the largest possible motion.
        """
        previous, odometry = self.state, self.odometry
        elapsed = now - previous.time  # infinite in the first cycle
        if not (math.isfinite(now) and elapsed > 0.0):
            return previous
        if joints is None:
            joints = self.base.read(now)
        if self._followers:
            self._supervise_motion(now)
        gap = self.gap_at(now)
        unusable = self._measure(joints, now)
        self._apply_staged_parameters()
        mode, commanded_twist, hold_reason = self._mode(now, gap, unusable)
        self._may_have_braked = self._may_have_braked or gap is not Gap.NONE
        measured = joints if self._may_have_braked and not unusable else None
        last = previous.command if self._follows else None
        if not unusable:
            self._may_have_braked = False
            if mode is DriveMode.HELD or not self._follows:
                # The base has held the joints until now, and may have moved them.
                self.calculator.reset(joints)
                self._ramp.restart(ZERO_TWIST)
                self._follows = mode is not DriveMode.HELD
        period = elapsed if math.isfinite(elapsed) else 1.0 / self.settings.rate
        infeasible = goal = ZERO_TWIST
        if commanded_twist != ZERO_TWIST:
            feasible = self.calculator.feasible(commanded_twist)
            if feasible is not commanded_twist:
                infeasible = commanded_twist.minus(feasible)
            goal = self._limited(feasible)
        if goal == ZERO_TWIST:
            command = self.calculator.stop(period, measured)
        else:
            command = self.calculator.command(self._ramp.follow(goal, period, last), joints, period)
        if goal == ZERO_TWIST or command.must_stop:
            self._ramp.restart(command.twist)
        self.base.write(command.joints, now)
        not_followed = ""
        if mode is DriveMode.DRIVING:
            not_followed = self._not_followed(now, commanded_twist, infeasible, command, joints)
        else:
            self._lasting_difference.reset()
        self.state = DriverState(
            now,
            mode,
            commanded_twist,
            self._ramp.twist,
            infeasible,
            command,
            odometry.joints,
            odometry.estimate,
            odometry.pose,
            odometry.covariance,
            (unusable or self.permission.value.fault) if mode is not DriveMode.HELD else "",
            hold_reason,
            not_followed,
        )
        return self.state

    # -- parts of a tick ----------------------------------------------------------

    def _supervise_motion(self, now: float) -> None:
        """Compares the motion of all motors with the commands of the last cycle."""
        deviations: list[Deviation] = []
        for follower in self._followers:
            text = follower.problem(now)
            if text:
                deviations.append(Deviation(follower.axis, text))
        if deviations:
            self.base.disobeyed(deviations, now)

    def _measure(self, joints: JointStates, now: float) -> str:
        """Updates the odometry.  Returns why the joint states are unusable, or an empty text."""
        try:
            self.odometry.update(joints, now)
        except ValueError as error:
            self.odometry.mark_missing(now)
            return str(error)
        return ""

    def _mode(self, now: float, gap: Gap, unusable: str) -> tuple[DriveMode, Twist, str]:
        """Returns the mode of the driver in this tick, the commanded twist in this mode, and the
        reason of the modes HELD and WAITING.  The first condition that holds decides::

            the base does not follow commands     HELD
            unusable joints, a long gap           FAULT
            disarmed, zero awaited                WAITING
            the last command is too old           TIMED_OUT; IDLE if there was none
            zero is commanded, and the ramp is 0  IDLE
            else                                  DRIVING
        """
        hold_reason = self.base.hold_reason
        if gap is not Gap.NONE:
            self.time_gaps.note(now)
            self._command_time = -math.inf
            # A base that does not follow joint commands stands or stops the robot itself.
            fault = gap is Gap.LONG and not hold_reason
            reason = gap_text(now - self.state.time)
            self.permission.step(Rules.void, reason, now, fault, every=False)
        if hold_reason:
            return DriveMode.HELD, ZERO_TWIST, hold_reason
        if not unusable or gap is not Gap.NONE:
            self._seen_at = now
        elif self.time_gaps.judge(now - self._seen_at) is not Gap.NONE:
            # The robot follows no source meanwhile, so that all commands are void as after a gap.
            self._command_time = -math.inf
            self.permission.step(Rules.void, f"no usable joint states ({unusable})", now)
        if unusable or self.permission.value.fault:
            return DriveMode.FAULT, ZERO_TWIST, ""
        if self.permission.value.void and self._commanded_twist == ZERO_TWIST:
            self.permission.step(Rules.command_zero, self._command_time)
        if reason := self.permission.value.waiting_reason or self.source_refusal:
            return DriveMode.WAITING, ZERO_TWIST, reason
        if now - self._command_time > self.settings.command_timeout + _TIME_TOLERANCE:
            if self._command_time == -math.inf:
                return DriveMode.IDLE, ZERO_TWIST, ""
            return DriveMode.TIMED_OUT, ZERO_TWIST, ""
        if self._commanded_twist == ZERO_TWIST and self._ramp.twist == ZERO_TWIST:
            return DriveMode.IDLE, ZERO_TWIST, ""
        return DriveMode.DRIVING, self._commanded_twist, ""

    def _not_followed(
        self,
        now: float,
        commanded: Twist,
        infeasible: Twist,
        command: BaseCommand,
        joints: JointStates,
    ) -> str:
        """Returns how the robot differs from the commanded twist for a long time, or nothing."""
        goal = commanded
        if infeasible is not ZERO_TWIST and is_axle_swing(commanded, infeasible):
            goal = Twist(commanded.vx - infeasible.vx, commanded.vy - infeasible.vy, commanded.wz)
        lasting = self._lasting_difference.update(now, goal, command.twist, self.settings)
        if not lasting:
            return ""
        limit = self.limit_of(commanded)
        text = difference_text(
            self.robot, self.calculator, commanded, infeasible, limit, command, joints
        )
        return f"for {lasting:.0f} s, the robot {text}"

    def limit_of(self, twist: Twist) -> str:
        """Returns the name and the value of the speed limit that scales a commanded twist, or an
        empty text if the twist is within the speed limits."""
        feasible = self.calculator.feasible(twist)
        limited = self._limited(feasible)
        if limited.speed >= feasible.speed * (1.0 - 1e-6) and (
            abs(limited.wz) >= abs(feasible.wz) * (1.0 - 1e-6)
        ):
            return ""
        share = self.speed_share
        part = f", {100.0 * share:.0f} % of it at present" if share < 1.0 else ""
        # The scaled twist reaches one of the limits, and is within the other.
        top_rate = share * self.settings.max_angular_velocity
        if abs(limited.wz) >= top_rate * (1.0 - 1e-6):
            return f"max_angular_velocity {self.settings.max_angular_velocity:.4g} rad/s{part}"
        return f"max_linear_velocity {self.settings.max_linear_velocity:.4g} m/s{part}"

    def limited(self, twist: Twist) -> Twist:
        """Returns the part of a commanded twist that the wheels and the speed limits allow."""
        return self._limited(self.calculator.feasible(twist))

    def _limited(self, twist: Twist) -> Twist:
        """Scales the twist so that it does not exceed the robot's speed limits."""
        settings, share = self.settings, self.speed_share
        top_speed = share * settings.max_linear_velocity
        top_rate = share * settings.max_angular_velocity
        scale, speed = 1.0, twist.speed
        if speed > top_speed:
            scale = top_speed / speed
        if abs(twist.wz) * scale > top_rate:
            scale = top_rate / abs(twist.wz)
        return twist.scaled(scale) if scale < 1.0 else twist
