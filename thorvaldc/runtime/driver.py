"""The base driver: one loop that drives any base, simulated or real."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.base import BaseHandle, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, TwistEstimate, for_robot
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, ZERO_TWIST, Cov3, Pose2, Twist

LONGEST_TICK = 0.5
"""Time (s) between ticks beyond which joint states no longer tell the way between them."""
LEAD = 0.1
"""Speed (m/s, of the wheels) by which the ramp may be ahead of what the wheels do."""
_SLACK = 1e-9


class DriveMode(enum.Enum):
    """What the driver is doing.

    ``IDLE``: no motion asked for.  ``DRIVING``: following a command.
    ``TIMED_OUT``: the last command is too old; ramping to or standing at zero.
    ``FAULT``: the joint states cannot be used; ramping to zero.
    """

    IDLE = "idle"
    DRIVING = "driving"
    TIMED_OUT = "timed out"
    FAULT = "fault"


@dataclass(slots=True)
class DriverState:
    """What a tick left: times in s, twists of ``base_link``, its pose where it started.

    ``asked`` is the twist of the command in force, ``infeasible`` the part of it
    that the wheels' arrangement does not allow, ``ramped`` the rest within the
    limits and ramps, ``command`` what was made of that.  ``odometry`` is the
    mean twist since the tick before; ``pose`` its integral and
    ``pose_covariance`` that of a small motion in ``base_link``.  ``fault`` says what
    is wrong, if anything is.
    """

    time: float
    mode: DriveMode
    asked: Twist
    ramped: Twist
    infeasible: Twist
    command: BaseCommand | None
    joints: JointStates | None
    odometry: TwistEstimate
    pose: Pose2
    pose_covariance: Cov3
    fault: str = ""


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
    ) -> None:
        """Raises ``RuntimeFault`` where the robot's calculator cannot drive it."""
        self.robot = robot
        self.base = base
        self.calculator = calculator or for_robot(robot)
        self.settings = settings or robot.driver
        self._asked = ZERO_TWIST
        self._asked_at = -math.inf
        self._ramped = ZERO_TWIST
        self._joints: JointStates | None = None
        nothing = TwistEstimate(ZERO_TWIST, ZERO_COV, 0)
        self.state = DriverState(
            -math.inf,
            DriveMode.IDLE,
            ZERO_TWIST,
            ZERO_TWIST,
            ZERO_TWIST,
            None,
            None,
            nothing,
            ORIGIN,
            ZERO_COV,
        )

    def command(self, twist: Twist, now: float) -> bool:
        """Follow ``twist`` from ``now`` on, for at most the command timeout.

        A twist that is not finite is refused (``False``): the one before stays
        in force until it times out.
        """
        if not twist.finite:
            return False
        self._asked = twist
        self._asked_at = now
        return True

    def reset_pose(self, pose: Pose2 = ORIGIN) -> None:
        """Set the odometry pose; its covariance starts again at zero."""
        self.state.pose = pose
        self.state.pose_covariance = ZERO_COV

    def tick(self, now: float) -> DriverState:
        """Read the joints, estimate, ramp, command.  A time that does not advance does nothing.

        After a gap of more than ``LONGEST_TICK`` the way since the tick before
        is unknown: the pose stays and its covariance grows by what the robot
        can have driven.
        """
        state = self.state
        first = not math.isfinite(state.time)
        dt = 0.0 if first else now - state.time
        if not first and not dt > 0.0:
            return state
        joints = self.base.read(now)
        fault = ""
        try:
            self.calculator.estimator.check(joints)
            odometry, pose, covariance = self._odometry(joints, dt)
        except ValueError as bad:
            fault = str(bad)
            odometry, pose, covariance = state.odometry, state.pose, state.pose_covariance
        mode, asked = self._mode(now, fault)
        period = dt if 0.0 < dt <= LONGEST_TICK else 1.0 / self.settings.rate
        infeasible = ZERO_TWIST
        if fault:
            # What the wheels do is unknown: ramp down by the commands alone.
            self._ramped = self._ramp(ZERO_TWIST, period)
            command = self.calculator.command(self._ramped, None, period)
        else:
            if self._joints is None:
                self.calculator.reset(joints)
            self._joints = joints
            allowed = self.calculator.allowed(asked)
            infeasible = Twist(asked.vx - allowed.vx, asked.vy - allowed.vy, asked.wz - allowed.wz)
            self._ramped = self._ramp(self._limited(allowed), period)
            command = self.calculator.command(self._ramped, joints, period)
        self.base.write(command.joints, now)
        self.state = DriverState(
            now,
            mode,
            asked,
            self._ramped,
            infeasible,
            command,
            self._joints,
            odometry,
            pose,
            covariance,
            fault,
        )
        return self.state

    # -- parts of a tick ----------------------------------------------------------

    def _mode(self, now: float, fault: str) -> tuple[DriveMode, Twist]:
        if fault:
            return DriveMode.FAULT, ZERO_TWIST
        if now - self._asked_at > self.settings.command_timeout + _SLACK:
            if self._asked_at == -math.inf:
                return DriveMode.IDLE, ZERO_TWIST
            return DriveMode.TIMED_OUT, ZERO_TWIST
        if self._asked == ZERO_TWIST and self._ramped == ZERO_TWIST:
            return DriveMode.IDLE, ZERO_TWIST
        return DriveMode.DRIVING, self._asked

    def _odometry(self, joints: JointStates, dt: float) -> tuple[TwistEstimate, Pose2, Cov3]:
        state = self.state
        before = self._joints
        if before is None or dt <= 0.0:
            return self.calculator.odometry(joints), state.pose, state.pose_covariance
        elapsed = joints.time - before.time
        if not 0.0 < elapsed <= LONGEST_TICK:
            estimate = self.calculator.odometry(joints)
            if elapsed <= 0.0:
                return estimate, state.pose, state.pose_covariance
            way = (self.settings.max_linear_velocity * elapsed) ** 2
            turn = (self.settings.max_angular_velocity * elapsed) ** 2
            (a, b, c), (_, d, e), (_, _, f) = state.pose_covariance
            grown = ((a + way, b, c), (b, d + way, e), (c, e, f + turn))
            return estimate, state.pose, grown
        estimate = self.calculator.odometry(_between(before, joints, elapsed))
        pose = state.pose.moved(se2.exp(estimate.twist, elapsed))
        covariance = se2.propagate(
            state.pose_covariance, estimate.twist, estimate.covariance, elapsed
        )
        return estimate, pose, covariance

    def _limited(self, twist: Twist) -> Twist:
        """The twist scaled as a whole to the robot's limits."""
        settings = self.settings
        scale = 1.0
        if twist.speed > settings.max_linear_velocity:
            scale = settings.max_linear_velocity / twist.speed
        if abs(twist.wz) * scale > settings.max_angular_velocity:
            scale = settings.max_angular_velocity / abs(twist.wz)
        return twist.scaled(scale) if scale < 1.0 else twist

    def _ramp(self, goal: Twist, dt: float) -> Twist:
        """One step from the twist of the last tick straight towards ``goal``.

        Straight in the space of twists: from rest and to rest the centre of
        rotation, and with it the steering, stays.
        """
        now = self._ramped
        if self.state.command is not None:
            now = self._within_reach(now, self.state.command)
        dv = math.hypot(goal.vx - now.vx, goal.vy - now.vy)
        dw = abs(goal.wz - now.wz)
        share = 1.0
        if dv > self.settings.max_linear_acceleration * dt:
            share = self.settings.max_linear_acceleration * dt / dv
        if dw * share > self.settings.max_angular_acceleration * dt:
            share = self.settings.max_angular_acceleration * dt / dw
        if share >= 1.0:
            return goal
        return Twist(
            now.vx + share * (goal.vx - now.vx),
            now.vy + share * (goal.vy - now.vy),
            now.wz + share * (goal.wz - now.wz),
        )

    def _within_reach(self, ramped: Twist, command: BaseCommand) -> Twist:
        """``ramped``, drawn back to what the wheels do where it has run ahead of them.

        Wheels that still turn, or are at their limits, make the robot slower than
        the ramp; without this it would jump once they are through.
        """
        doing = command.twist
        dx, dy, dw = ramped.vx - doing.vx, ramped.vy - doing.vy, ramped.wz - doing.wz
        lever = self.calculator.geometry.length
        ahead = math.sqrt(dx * dx + dy * dy + lever * lever * dw * dw)
        if ahead <= LEAD:
            return ramped
        share = LEAD / ahead
        return Twist(doing.vx + share * dx, doing.vy + share * dy, doing.wz + share * dw)


def _between(before: JointStates, after: JointStates, dt: float) -> JointStates:
    """The mean joint states of an interval: speeds from the ways where they are counted."""
    if before.positions is not None and after.positions is not None:
        speeds = tuple((b - a) / dt for a, b in zip(before.positions, after.positions, strict=True))
    else:
        speeds = tuple((a + b) / 2.0 for a, b in zip(before.speeds, after.speeds, strict=True))
    pairs = tuple(zip(before.angles, after.angles, strict=True))
    return JointStates(
        after.time,
        speeds,
        tuple((a + b) / 2.0 for a, b in pairs),
        tuple((b - a) / dt for a, b in pairs),
    )
