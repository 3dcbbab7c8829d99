"""The calculator for any arrangement of driven, steered, fixed and swivelling wheels.

Inverse kinematics: the steering axis of a wheel at (x, y) moves with

    u = (vx - wz y, vy + wz x),   speed v = |u|,   direction phi = atan2(u_y, u_x)

Each steered wheel points along or against phi (``steering_branch`` chooses) and rolls at +-v.
One factor min(v_max / v_i) <= 1 scales the whole twist, so that the centre of rotation stays.

While wheels still turn to their angles, speeds for the commanded twist would make them fight each
other.  The speeds then follow the twist that scrubs least at the present angles theta,

    xi* = argmin sum (T_i(theta_i) xi)^2 + lambda |xi - xi_target|^2

with the side-slip rows T of ``WheelGeometry.rows``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, Noise
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.linear_algebra import solve3
from thorvaldc.runtime.calculators.motor_limits import DriveMotors
from thorvaldc.runtime.calculators.skid_steering import SkidSteering
from thorvaldc.runtime.calculators.steering_branch import SteeringJoint
from thorvaldc.runtime.calculators.twist_estimator import EstimatorOptions, TwistEstimator
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_FOLLOW_WEIGHT = 0.01
"""lambda for wheels far from their angles: following the command against not scrubbing."""
_ROLLING = 0.05
"""Speed (m/s) above which a wheel scrubs noticeably if it points in a wrong direction."""
_MAX_TURN_ROLLING = math.pi / 4.0
"""Largest turn (rad) of a rolling wheel in one step; for more, the robot stops first."""
_MIN_SHARE = 0.1
"""Share of the way to a twist below which a wheel cannot go on: it is at a steering limit."""
_STANDING = 1e-6
"""Square of the speed (m^2/s^2) below which a robot stands."""
_ALIGNED = math.radians(1.0)
"""Misalignment (rad) up to which wheels count as aligned, so that servo errors cost no speed."""


@dataclass(frozen=True, slots=True)
class SteeringOptions:
    """Options of calculators that steer.

    ``hysteresis`` (s): a wheel changes between rolling forwards and backwards only if that saves
    more time.  ``arrive_together``: all wheels take the same time to turn to new angles.
    """

    hysteresis: float = 0.02
    arrive_together: bool = True

    def __post_init__(self) -> None:
        if not 0.0 <= self.hysteresis <= 10.0:
            raise ValueError(f"hysteresis is {self.hysteresis:g} s; it must be 0 to 10 s")


@dataclass(frozen=True, slots=True)
class GeneralOptions(SteeringOptions):
    """Options of ``general``, in addition to those of steering.

    ``faulty_wheels``: largest number of wheels that odometry leaves out, 0 to 2.
    ``polish``: further steps of its fit towards maximum likelihood.
    """

    faulty_wheels: int = 2
    polish: int = 0

    def __post_init__(self) -> None:
        # slots=True creates a new class, for which super() without arguments fails.
        SteeringOptions.__post_init__(self)
        if self.faulty_wheels not in (0, 1, 2):
            raise ValueError(f"faulty_wheels is {self.faulty_wheels}; it must be 0, 1 or 2")
        if not 0 <= self.polish <= 10:
            raise ValueError(f"polish is {self.polish}; it must be 0 to 10")


class General(BaseCalculator):
    """Each wheel follows the velocity of the twist at its position; see the module.

    Order of a command: reduce the twist to what fixed wheels allow, choose the steering angles,
    slow down for late steering joints, move the joints, compute the wheel speeds, limit them.
    """

    name = "general"
    summary = "any arrangement of driven, steered, fixed and free wheels"
    Options = GeneralOptions

    def __init__(
        self,
        geometry: BaseGeometry,
        options: GeneralOptions | None = None,
        noise: Noise | None = None,
    ) -> None:
        super().__init__(geometry, options, noise)
        estimation = EstimatorOptions(faulty=self.options.faulty_wheels, polish=self.options.polish)
        self.estimator = TwistEstimator(geometry, noise, estimation)
        wheels = geometry.wheels
        self._fixed = FixedWheels(wheels)
        self._unconstrained = self._fixed.unconstrained
        self._skid = SkidSteering.from_geometry(geometry, self._fixed)
        self._length2 = geometry.length**2
        self._motors = DriveMotors(geometry)
        self._has_shared_motors = bool(geometry.spin_groups)
        self._zeros = (0.0,) * len(wheels)
        self._steering = tuple(
            SteeringJoint(
                wheels[group[0]],
                group,
                min(wheels[i].max_acceleration * wheels[i].radius for i in group),
                self.options.hysteresis,
            )
            for group in geometry.steering_groups
        )
        # Constants of each wheel for the loops of a tick, unpacked to avoid attribute lookups.
        self._joints = tuple(
            (s, s.wheels[0], s.wheel.x, s.wheel.y, s.wheel.radius) for s in self._steering
        )
        steered = [(i, s, wheels[i]) for s in self._steering for i in s.wheels]
        self._steered = tuple((i, s) for i, s, _ in steered)
        # (index, joint, rad/s per m/s of rolling of the joint's first wheel, lateral offset over
        # radius, speed limit in rad/s)
        self._driven_steered = tuple(
            (
                i,
                s,
                math.cos(w.heading - s.wheel.heading) / w.radius,
                w.lateral / w.radius,
                w.max_speed,
            )
            for i, s, w in steered
            if w.driven
        )
        self._scrubbing = tuple(
            (i, s, w.heading, w.sign, w.x, w.y, w.trail, w.lateral, w.radius, w.driven)
            for i, s, w in steered
        )
        self._driven_fixed = tuple(
            (i, *w.rows(0.0)[0], w.radius, w.max_speed)
            for i, w in enumerate(wheels)
            if w.fixed and w.driven
        )
        self.reset()

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        if not geometry.wheels:
            return "it has no wheels"
        if not any(w.driven and not w.swivel for w in geometry.wheels):
            return "no wheel with a motor holds its direction"
        return None

    def reset(self, states: JointStates | None = None) -> None:
        self._angles: tuple[float, ...] = self._zeros
        self._last_target = ZERO_TWIST
        self._stopping = False
        self._aligned = True
        for joint in self._steering:
            joint.reset(states.angles[joint.wheels[0]] if states else 0.0)
        self._store_angles()
        if states is None:
            self._motors.reset()
        else:
            self._motors.reset(states, self.estimator.estimate(states).twist)

    def resume(self, previous: Self) -> None:
        for joint, previous_joint in zip(self._steering, previous._steering, strict=True):
            joint.resume(previous_joint)
        self._angles = previous._angles
        self._last_target = previous._last_target
        self._stopping, self._aligned = previous._stopping, previous._aligned
        self._motors.resume(previous._motors)

    def feasible(self, twist: Twist) -> Twist:
        return self._fixed.feasible(twist)

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        target, infeasible = twist, ZERO_TWIST
        if not self._unconstrained:
            target = self._fixed.feasible(twist)
            infeasible = Twist(twist.vx - target.vx, twist.vy - target.vy, twist.wz - target.wz)
        angles: Sequence[float] = self._angles
        speeds: Sequence[float] = self._zeros
        if states is not None:
            angles, speeds = states.angles, states.speeds
        last_twist = self._motors.twist
        must_stop = self._stopping and self._square(last_twist) > _STANDING
        rates: Sequence[float] = self._zeros
        unreachable: tuple[int, ...] = ()
        if not must_stop:
            unreachable = self._choose_angles(target, angles, speeds)
            rates, ticks, self._aligned = self._steering_delay(dt)
            if ticks > 1.0:
                target, unreachable, must_stop = self._slow_down(target, ticks, angles, speeds, dt)
            if not must_stop:
                self._last_target = target
        self._stopping = must_stop
        self._move_steering(dt)
        target_speeds, scale = self._target_speeds(target)
        if scale < 1.0:
            target = target.scaled(scale)
        current = target
        if states is None:
            angles = self._angles
        if dt is not None or states is not None:
            misalignment = self._misalignment(angles)
            if must_stop:
                goal = target if self._square(target) < self._square(last_twist) else ZERO_TWIST
                current, target_speeds = self._least_scrub(goal, angles, math.inf)
            elif misalignment > _ALIGNED:
                current, target_speeds = self._least_scrub(target, angles, misalignment)
        current, limited_speeds = self._motors.limit_accelerations(current, target_speeds, dt)
        return BaseCommand(
            JointCommands(limited_speeds, self._angles),
            target,
            current,
            infeasible,
            scale,
            unreachable,
            rates,
            must_stop,
            self._aligned,
        )

    def _square(self, twist: Twist) -> float:
        """Returns the square (m^2/s^2) of a twist: of the root mean square speed of the wheels."""
        vx, vy, wz = twist
        return vx * vx + vy * vy + self._length2 * wz * wz

    # -- steering -----------------------------------------------------------------

    def _choose_angles(
        self, twist: Twist, angles: Sequence[float], speeds: Sequence[float]
    ) -> tuple[int, ...]:
        """Chooses the target angle of every joint; returns the wheels without a reachable one."""
        vx, vy, wz = twist
        unreachable: tuple[int, ...] = ()
        for joint, i, x, y, radius in self._joints:
            joint.choose(vx - wz * y, vy + wz * x, wz, angles[i], speeds[i] * radius)
            if joint.unreachable:
                unreachable += joint.wheels
        return unreachable

    def _steering_delay(self, dt: float | None) -> tuple[Sequence[float], float, bool]:
        """Returns the required rates, the ticks of the latest rolling wheel, and ``aligned``.

        Required rates (rad/s, per wheel) would reach the target angles within this tick.  The
        ticks are infinite if a rolling wheel has to turn further than it may.
        """
        if dt is None:
            return self._zeros, 0.0, True
        rates = list(self._zeros)
        latest, aligned = 0.0, True
        vx, vy, wz = self._motors.twist
        for joint, _, x, y, _ in self._joints:
            gap = joint.target - joint.angle
            for i in joint.wheels:
                rates[i] = gap / dt
            if joint.holding:
                continue
            too_far = not -_MAX_TURN_ROLLING <= gap <= _MAX_TURN_ROLLING
            if too_far:
                aligned = False
            ux, uy = vx - wz * y, vy + wz * x
            if ux * ux + uy * uy >= _ROLLING * _ROLLING:
                ticks = math.inf if too_far else abs(gap) * joint.seconds_per_rad / dt
                if ticks > latest:
                    latest = ticks
        return rates, latest, aligned

    def _slow_down(
        self,
        target: Twist,
        ticks: float,
        angles: Sequence[float],
        speeds: Sequence[float],
        dt: float | None,
    ) -> tuple[Twist, tuple[int, ...], bool]:
        """Slows the change of the twist so that all rolling wheels keep up.

        Returns the twist, the unreachable wheels, and whether a wheel at a steering limit must
        turn around.  The twist lies between the last target and ``target``, as far as the wheels
        follow within a tick; ``ticks`` is what they need for ``target``.
        """
        start, share = self._last_target, 1.0
        ratio = self._square(target) / max(self._square(start), 1e-12)
        if ratio < 1.0:  # a slower command slows the robot down, even while it waits for wheels
            start = start.scaled(math.sqrt(ratio))
        unreachable = self._choose_angles(start, angles, speeds)
        _, start_ticks, _ = self._steering_delay(dt)
        if start_ticks >= 1.0:
            return start, unreachable, False
        slower = target
        while ticks > 1.0:
            # Halve the way if a wheel would turn too far; else interpolate the ticks to 1.
            share *= 0.5 if ticks == math.inf else (1.0 - start_ticks) / (ticks - start_ticks)
            if ticks == math.inf and share < _MIN_SHARE:
                return start, self._choose_angles(start, angles, speeds), True
            slower = Twist(
                start.vx + share * (target.vx - start.vx),
                start.vy + share * (target.vy - start.vy),
                start.wz + share * (target.wz - start.wz),
            )
            unreachable = self._choose_angles(slower, angles, speeds)
            if ticks < math.inf:
                break
            _, ticks, _ = self._steering_delay(dt)
        return slower, unreachable, False

    def _move_steering(self, dt: float | None) -> None:
        """Moves the joints towards their targets for ``dt`` s (``None``: to their targets)."""
        if dt is None:
            for joint in self._steering:
                joint.jump()
        else:
            slowest = 0.0
            for joint in self._steering:
                time = abs(joint.target - joint.angle) * joint.seconds_per_rad
                if time > slowest:
                    slowest = time
            # A wheel that arrives within two ticks does not wait for the others.
            together = slowest > 2.0 * dt and self.options.arrive_together
            for joint in self._steering:
                joint.advance(dt, joint.time_to_target() / slowest if together else 1.0)
        self._store_angles()

    def _store_angles(self) -> None:
        angles = list(self._zeros)
        for i, joint in self._steered:
            angles[i] = joint.angle
        self._angles = (*angles,)

    def _misalignment(self, angles: Sequence[float]) -> float:
        """Returns the largest angle (rad) between a wheel and its target; inf if unreachable."""
        largest = 0.0
        for joint, i, _, _, _ in self._joints:
            if joint.holding:
                if joint.unreachable:
                    return math.inf
            else:
                difference = abs(angles[i] - joint.target)
                if difference > largest:
                    largest = difference
        return largest

    # -- speeds -------------------------------------------------------------------

    def _target_speeds(self, target: Twist) -> tuple[list[float], float]:
        """Returns the speeds (rad/s) of wheels at their target angles, and the common scale."""
        speeds = list(self._zeros)
        scale = 1.0
        wz = target.wz
        for i, joint, gain, lateral, limit in self._driven_steered:
            v = joint.rolling * gain
            if lateral and not joint.unreachable:
                # A contact beside the axis rolls around it, also at the centre of rotation.
                v -= lateral * (wz + joint.wheel.sign * joint.rate)
            speeds[i] = v
            if v > limit or v < -limit:
                scale = min(scale, limit / abs(v))
        if self._driven_fixed:
            scale = self._set_fixed_speeds(target, speeds, scale)
        if scale < 1.0:
            speeds = [v * scale for v in speeds]
        return self._motors.average_shared(speeds) if self._has_shared_motors else speeds, scale

    def _set_fixed_speeds(self, twist: Twist, speeds: list[float], scale: float) -> float:
        """Sets the speeds (rad/s) of the fixed wheels, in place; returns the smaller scale."""
        vx, vy, wz = self._skid.compensate(twist) if self._skid else twist
        for i, l1, l2, l3, radius, limit in self._driven_fixed:
            speeds[i] = v = (l1 * vx + l2 * vy + l3 * wz) / radius
            if v * scale > limit or v * scale < -limit:
                scale = limit / abs(v)
        return scale

    def _least_scrub(
        self, target: Twist, angles: Sequence[float], misalignment: float
    ) -> tuple[Twist, list[float]]:
        """Returns the twist that scrubs least at these angles, and its wheel speeds (rad/s).

        With G = diag(1, 1, length^2) and d = xi* - target, the minimum is at

            (sum T'T + lambda G) d = -sum T' (T target)

        Solving for the difference d loses no digits near the target.  lambda grows to infinity as
        the misalignment decreases to ``_ALIGNED``, so that the twist is continuous there.
        """
        follow = _FOLLOW_WEIGHT / (1.0 - (_ALIGNED / misalignment) ** 2)
        vx, vy, wz = target
        directions = []
        a12 = a13 = a23 = b1 = b2 = b3 = 0.0
        a11 = a22 = follow
        a33 = follow * self._length2
        for i, joint, heading, sign, x, y, trail, _, _, _ in self._scrubbing:
            direction = heading + sign * angles[i]
            c, s = math.cos(direction), math.sin(direction)
            directions.append((c, s))
            if joint.holding and not joint.unreachable:
                continue
            t3 = c * x + s * y + trail
            slip = c * vy - s * vx + t3 * wz
            if trail:
                slip += trail * sign * joint.rate
            a11 += s * s
            a12 -= s * c
            a13 -= s * t3
            a22 += c * c
            a23 += c * t3
            a33 += t3 * t3
            b1 += s * slip
            b2 -= c * slip
            b3 -= t3 * slip
        # The target is feasible: it has no side slip on fixed wheels.
        for t1, t2, t3 in self._fixed.rows:
            a11 += t1 * t1
            a12 += t1 * t2
            a13 += t1 * t3
            a22 += t2 * t2
            a23 += t2 * t3
            a33 += t3 * t3
        dx, dy, dw = solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)
        vx, vy, wz = vx + dx, vy + dy, wz + dw
        speeds = list(self._zeros)
        for (i, joint, _, sign, x, y, _, lateral, radius, driven), (c, s) in zip(
            self._scrubbing, directions, strict=True
        ):
            if not driven or joint.unreachable:
                continue
            v = -lateral * (wz + sign * joint.rate) if lateral else 0.0
            if not joint.holding:
                v += c * (vx - wz * y) + s * (vy + wz * x)
            speeds[i] = v / radius
        twist = Twist(vx, vy, wz)
        if self._driven_fixed:
            self._set_fixed_speeds(twist, speeds, 1.0)
        twist, speeds = self._motors.limit_speeds(twist, speeds)
        return twist, self._motors.average_shared(speeds)
