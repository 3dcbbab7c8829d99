"""The base driver: one loop that drives any base, simulated or real."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, TwistEstimate, for_robot
from thorvaldc.runtime.driver_parameters import Parameters
from thorvaldc.runtime.odometry import LONGEST_INTERVAL, Odometry
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST, Cov3, Pose2, Twist
from thorvaldc.runtime.twist_ramp import Ramp

BEYOND = 1e9
"""Twist (m/s, rad/s) that nobody can have meant."""
_SLACK = 1e-9


class DriveMode(enum.Enum):
    """What the driver is doing.

    ``IDLE``: no motion asked for.  ``DRIVING``: following a command.
    ``TIMED_OUT``: the last command is too old; ramping to or standing at zero.
    ``FAULT``: the joint states cannot be used; ramping to zero.
    ``HELD``: the base follows nobody now, and sees to its standing still itself.
    """

    IDLE = "idle"
    DRIVING = "driving"
    TIMED_OUT = "timed out"
    FAULT = "fault"
    HELD = "held"


@dataclass(slots=True)
class DriverState:
    """What a tick left: times in s, twists of ``base_link``, its pose where it started.

    ``asked`` is the twist of the command in force, ``infeasible`` the part of it
    that the wheels' arrangement does not allow, ``ramped`` the rest within the
    limits and ramps, ``command`` what was made of that.  ``odometry`` is the
    mean twist since the tick before; ``pose`` its integral and
    ``pose_covariance`` that of a small motion in ``base_link``.  ``fault`` says what
    is wrong, if anything is, and ``held`` why the base follows nobody.
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


class BaseDriver:
    """Drives a robot's base: watchdog, limits, ramps, calculator, odometry.

    ``tick(now)`` is called at ``rate`` Hz with a monotonic time.  All that the
    driver does depends on those times alone, so that a simulation repeats.
    """

    def __init__(
        self,
        robot: Robot,
        base: BaseHandle,
        calculator: BaseCalculator | None = None,
        settings: DriverSettings | None = None,
        parameters: str | None = None,
    ) -> None:
        """``parameters`` names the set to start with, in place of the ordinary values.

        Raises ``DiagnosticError`` where the robot's calculator cannot drive it and
        where it has no such set.
        """
        self.robot = robot
        self.base = base
        self.parameters = Parameters.from_robot(robot, parameters)
        if settings is not None:
            self.parameters = replace(self.parameters, settings=settings)
        self.calculator = calculator or for_robot(robot).with_parameters(
            self.parameters.radii, self.parameters.noise
        )
        self._staged: tuple[Parameters, BaseCalculator] | None = None
        self._asked = ZERO_TWIST
        self._asked_at = -math.inf
        geometry = self.calculator.geometry
        self._ramp = Ramp(self.settings, geometry.length, geometry.steering_time)
        self._stops = False
        self.odometry = Odometry(self.calculator, self._fastest)
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

    def command(self, twist: Twist, now: float) -> bool:
        """Follow ``twist`` from ``now`` on, for at most the command timeout.

        A twist or a time that is not finite, or beyond all bounds, is refused
        (``False``): the twist before stays in force until it times out.
        """
        if not (sum(map(abs, twist)) < BEYOND and math.isfinite(now)):
            return False
        self._asked = twist
        self._asked_at = now
        return True

    def commanded_twist(self, now: float) -> Twist:
        """The twist of the command in force at ``now``; zero where it is too old."""
        old = now - self._asked_at > self.settings.command_timeout + _SLACK
        return ZERO_TWIST if old else self._asked

    @property
    def settings(self) -> DriverSettings:
        """The settings in force."""
        return self.parameters.settings

    @property
    def _fastest(self) -> tuple[float, float]:
        return self.settings.max_linear_velocity, self.settings.max_angular_velocity

    def use(self, parameters: str | None) -> None:
        """Switch to a parameter set of the robot's file, to the ordinary values for ``None``.

        In force from the end of the next tick's odometry on: the way until then is
        that of the radii before, and the pose stays.  Raises ``DiagnosticError`` where
        there is no such set; then nothing changes.
        """
        self._stage(Parameters.from_robot(self.robot, parameters))

    def update(
        self,
        *,
        radii: Mapping[str, float] | None = None,
        noise: Mapping[str, float] | None = None,
        **limits: float,
    ) -> None:
        """Change some parameters: radii (m) by wheel, noise by name, limits such as
        ``max_linear_velocity`` (SI).

        All or none, from the end of the next tick's odometry on, as with ``use``.
        Raises ``ParameterError`` where a name is not known or a value cannot be.
        """
        current = self._staged[0] if self._staged is not None else self.parameters
        self._stage(current.changed(self.robot, radii, noise, limits))

    def _stage(self, parameters: Parameters) -> None:
        made = self.calculator.with_parameters(parameters.radii, parameters.noise)
        self._staged = (parameters, made)

    def _change_over(self) -> None:
        if self._staged is not None:
            self.parameters, made = self._staged
            self._staged = None
            made.resume(self.calculator)
            self.calculator = self.odometry.calculator = made
            self.odometry.fastest = self._fastest
            self._ramp.settings = self.settings

    def reset_pose(self, pose: Pose2 = ORIGIN) -> None:
        """Set the odometry pose; its covariance starts again at zero."""
        self.odometry.reset(pose)
        self.state.pose = self.odometry.pose
        self.state.pose_covariance = self.odometry.covariance

    def tick(self, now: float, joints: JointStates | None = None) -> DriverState:
        """Read the joints, estimate, ramp, command.  A time that does not advance does nothing.

        ``joints`` are those that the base was read for at this time, where it was already.

        Without usable joints, and after more than ``LONGEST_INTERVAL`` without, the
        way is unknown: the pose stays and its covariance grows by what the robot can
        have driven.
        """
        state = self.state
        first = not math.isfinite(state.time)
        dt = 0.0 if first else now - state.time
        if not math.isfinite(now) or not (first or dt > 0.0):
            return state
        if joints is None:
            joints = self.base.read(now)
        odometry = self.odometry
        fault = ""
        starts = odometry.joints is None
        try:
            odometry.update(joints, now)
        except ValueError as bad:
            fault = str(bad)
            odometry.miss(now)
        self._change_over()
        held = self.base.hold_reason
        mode, asked = self._mode(now, fault, held)
        period = dt if 0.0 < dt <= LONGEST_INTERVAL else 1.0 / self.settings.rate
        infeasible = ZERO_TWIST
        if held:
            # It stands, or stops by itself: afterwards the ramp starts from rest.
            self._ramp.restart(ZERO_TWIST)
        if fault:
            # What the wheels do is unknown: ramp down by the commands alone.
            command = self.calculator.command(self._ramped(ZERO_TWIST, period), None, period)
        else:
            if starts or held:
                self.calculator.reset(joints)
            allowed = self.calculator.feasible(asked)
            infeasible = Twist(asked.vx - allowed.vx, asked.vy - allowed.vy, asked.wz - allowed.wz)
            ramped = self._ramped(self._limited(allowed), period)
            command = self.calculator.command(ramped, joints, period)
        self.base.write(command.joints, now)
        self.state = DriverState(
            now,
            mode,
            asked,
            self._ramp.twist,
            infeasible,
            command,
            odometry.joints,
            odometry.estimate,
            odometry.pose,
            odometry.covariance,
            fault,
            held,
        )
        return self.state

    # -- parts of a tick ----------------------------------------------------------

    def _mode(self, now: float, fault: str, held: str) -> tuple[DriveMode, Twist]:
        if held:
            return DriveMode.HELD, ZERO_TWIST
        if fault:
            return DriveMode.FAULT, ZERO_TWIST
        if now - self._asked_at > self.settings.command_timeout + _SLACK:
            if self._asked_at == -math.inf:
                return DriveMode.IDLE, ZERO_TWIST
            return DriveMode.TIMED_OUT, ZERO_TWIST
        if self._asked == ZERO_TWIST and self._ramp.twist == ZERO_TWIST:
            return DriveMode.IDLE, ZERO_TWIST
        return DriveMode.DRIVING, self._asked

    def _limited(self, twist: Twist) -> Twist:
        """The twist scaled as a whole to the robot's limits."""
        settings = self.settings
        scale, speed = 1.0, twist.speed
        if speed > settings.max_linear_velocity:
            scale = settings.max_linear_velocity / speed
        if abs(twist.wz) * scale > settings.max_angular_velocity:
            scale = settings.max_angular_velocity / abs(twist.wz)
        return twist.scaled(scale) if scale < 1.0 else twist

    def _ramped(self, goal: Twist, dt: float) -> Twist:
        """One step of the ramp towards ``goal``; to rest first, where a wheel must turn around."""
        last, ramp = self.state.command, self._ramp
        if last is not None:
            if last.must_stop != self._stops:
                self._stops = last.must_stop
                ramp.restart(last.twist)
            ramp.draw_back(last.twist, last.aligned)
        return ramp.step(ZERO_TWIST if self._stops else goal, dt)
