"""Base calculator for any arrangement of driven, steered, fixed and swivelling wheels.

Inverse kinematics: velocity u of the steering axis of a wheel at the position (x, y):

    u = (vx - wz y, vy + wz x),   speed v = |u|,   direction phi = atan2(u_y, u_x)

Each steered wheel points along its direction of motion and rolls forwards, or points in the
opposite direction and rolls backwards.  The module ``steering_branch`` chooses whether a wheel
rolls forwards or backwards.  If a wheel speed v_i exceeds its limit v_max, the whole twist is
scaled by the factor min(v_max / v_i).  With the same factor for all wheels, the centre of rotation
does not change.

While wheels turn to new steering angles, the wheel speeds of the commanded twist contradict each
other and would make wheels slip.  Until the wheels reach their target angles, the wheel speeds
therefore produce the twist xi* that causes the least scrub at the present steering angles theta:

    xi* = argmin sum (T_i(theta_i) xi)^2 + lambda |xi - xi_target|^2

T_i is the side-slip row of wheel i (see ``WheelGeometry.rows``), and lambda is a small weight.
If xi* is larger than xi_target, xi* is scaled down to the size of xi_target: the robot would
otherwise follow the sideways motion of turning contact points with trail, much too fast.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Final, Self

from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, Noise
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.calculator_options import GeneralOptions as GeneralOptions
from thorvaldc.runtime.calculators.reachable_twists import ReachableTwists, SkidSteering
from thorvaldc.runtime.calculators.steering_branch import DriveMotors, SteeringJoint
from thorvaldc.runtime.calculators.twist_estimator import EstimatorOptions, TwistEstimator
from thorvaldc.runtime.calculators.twist_fit import least_squares3, solve3
from thorvaldc.runtime.mypyc_marks import mypyc_attr
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_FOLLOW_WEIGHT: Final = 0.01
"""Weight lambda of the commanded twist in the least-scrub equation, for large steering errors."""
_ROLLING: Final = 0.05
"""Above this speed (m/s), a wheel with a wrong steering angle scrubs noticeably."""
_MAX_TURN_ROLLING: Final = math.pi / 4.0
"""Largest change of the steering angle (rad) that a wheel makes while the robot moves."""
_MIN_SHARE: Final = 0.1
"""Smallest allowed share of a change of the twist in one tick.

Below it, a wheel is at a steering limit and must turn to the opposite direction.
"""
_KEEP_WEIGHT: Final = 0.01
"""Weight epsilon of the interpolated twist in the fit of a twist to wheel speeds.

Nearly parallel wheels hardly determine the motion across them.  The weight bounds the correction to
five times the largest difference of the rolling speeds.
"""
_SAME_SPEED: Final = 1e-12
"""Differences of rolling speeds (m/s) up to this limit are rounding errors."""
_ALIGNED: Final = math.radians(1.0)
"""Largest steering error (rad) of an aligned wheel: smaller ones do not change the wheel speeds."""


@mypyc_attr(allow_interpreted_subclasses=True)
class General(BaseCalculator):
    """Base calculator for any arrangement of driven, steered, fixed and swivelling wheels.

    The documentation of the module ``general`` contains the equations.

    Steps of the method ``command``:

    1.  Replace the commanded twist by one that the fixed wheels and the steering limits allow.
    2.  Choose the target angles of all steering joints.
    3.  Reduce the change of the twist if steering joints cannot follow it within one tick.
    4.  Move the commanded steering angles towards the target angles.
    5.  Compute the wheel speeds and apply the speed and acceleration limits.
    """

    name = "general"
    summary = "any arrangement of driven, steered, fixed and free wheels"
    Options: ClassVar[type] = GeneralOptions

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
        self._reachable = ReachableTwists(geometry, self._fixed)
        self._unconstrained = self._fixed.unconstrained and self._reachable.unlimited
        self._skid = SkidSteering.from_geometry(geometry, self._fixed)
        self._length2 = geometry.length**2
        self._motors = DriveMotors(geometry)
        self._has_shared_motors = bool(geometry.spin_groups)
        self._zeros = (0.0,) * len(wheels)
        self._steering = tuple(
            SteeringJoint(wheels, group, self.options.hysteresis)
            for group in geometry.steering_groups
        )
        # Tuples of constants are faster than attribute lookups.
        self._joints = tuple(
            (s, s.wheels[0], s.wheel.x, s.wheel.y, s.wheel.radius) for s in self._steering
        )
        steered = [(i, s, wheels[i]) for s in self._steering for i in s.wheels]
        self._steered = tuple((i, s) for i, s, _ in steered)
        # Fields: wheel index, steering joint, wheel speed (rad/s) per m/s of the rolling speed of
        # the joint's first wheel, lateral offset divided by the radius, speed limit (rad/s).
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
        # Fields: wheel index, steering joint, wheel speed in rad/s per rad/s of the joint's rate.
        self._pushing = tuple(
            (i, s, -w.sign * w.lateral / w.radius) for i, s, w in steered if w.driven and w.lateral
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
        self._turns_around = False
        self._aligned = True
        self._reachable.reset()
        for joint in self._steering:
            joint.reset(states.angles[joint.wheels[0]] if states else 0.0)
        self._store_angles()
        self._motors.reset()

    def resume(self, previous: Self) -> None:
        for joint, previous_joint in zip(self._steering, previous._steering, strict=True):
            joint.resume(previous_joint)
        self._angles = previous._angles
        self._last_target = previous._last_target
        self._turns_around, self._aligned = previous._turns_around, previous._aligned
        self._reachable.resume(previous._reachable)
        self._motors.resume(previous._motors)

    @property
    def commanded_speeds(self) -> Sequence[float] | None:
        return self._motors.commanded_speeds if self._motors.has_commanded else None

    def feasible(self, twist: Twist) -> Twist:
        return self._reachable.feasible(twist)

    def limiting_wheels(self, twist: Twist) -> tuple[int, ...]:
        return self._reachable.project(twist).limiting

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        target, infeasible = twist, ZERO_TWIST
        unreachable: tuple[int, ...] = ()
        if not self._unconstrained:
            target, unreachable = self._reachable.project(twist)
            infeasible = twist.minus(target)
        rates: Sequence[float] = self._zeros
        if not self._steering:  # a shortcut: the steps below change nothing without steering joints
            target_speeds, scale = self._target_speeds(target)
            if scale < 1.0:
                target = target.scaled(scale)
            current, limited_speeds = self._motors.limit_accelerations(target, target_speeds, dt)
            joints = JointCommands(limited_speeds, self._zeros)
            return BaseCommand(joints, target, current, infeasible, scale, unreachable, rates)
        angles: Sequence[float] = self._angles
        speeds: Sequence[float] = self._zeros
        if states is not None:
            angles, speeds = states.angles, states.speeds
        if not self._turns_around:
            self._choose_angles(target, angles, speeds)
            rates, ticks, self._aligned = self._steering_delay(dt)
            if ticks > 1.0:
                target, self._turns_around = self._slow_down(target, ticks, angles, speeds, dt)
        if self._turns_around and dt is not None:
            return self.stop(dt)
        self._last_target = target
        if not self._unconstrained:
            self._reachable.keep(target)
        self._move_steering(dt)
        pushes = self._pushes() if self._pushing else None
        target_speeds, scale = self._target_speeds(target)
        if scale < 1.0:
            target = target.scaled(scale)
        current = target
        if states is None:
            angles = self._angles
        at_targets = True
        if dt is not None or states is not None:
            misalignment = self._misalignment(angles)
            at_targets = misalignment <= _ALIGNED
            if not at_targets:
                current, target_speeds = self._least_scrub(target, angles, misalignment, pushes)
        unlimited = current
        current, limited_speeds = self._motors.limit_accelerations(
            current, target_speeds, dt, pushes
        )
        if current is not unlimited:
            rolling_speeds = self._motors.rolling_speeds
            current = self._rolling_twist(current, rolling_speeds, angles, at_targets)
            self._motors.twist = current
        joints = JointCommands(limited_speeds, self._angles)
        return BaseCommand(
            joints, target, current, infeasible, scale, unreachable, rates, False, self._aligned
        )

    def stop(self, dt: float, measured: JointStates | None = None) -> BaseCommand:
        for joint in self._steering:
            joint.brake(dt)
        self._store_angles()
        pushes = self._pushes() if self._pushing else None
        self._motors.brake(dt, self.decelerations, measured, pushes)
        self._last_target = twist = self._motors.twist
        must_stop = self._turns_around
        self._turns_around = must_stop and twist != ZERO_TWIST
        joints = JointCommands(self._motors.commanded_speeds, self._angles)
        return BaseCommand(joints, twist, twist, ZERO_TWIST, 1.0, (), self._zeros, must_stop)

    def _square(self, twist: Twist) -> float:
        """Returns the squared size vx^2 + vy^2 + (length wz)^2 of a twist, in m^2/s^2.

        The result is the mean square speed of the wheels if the centroid of the wheels is at the
        origin of ``base_link``.
        """
        vx, vy, wz = twist
        return vx * vx + vy * vy + self._length2 * wz * wz

    # -- steering -----------------------------------------------------------------

    def _choose_angles(
        self, twist: Twist, angles: Sequence[float], speeds: Sequence[float]
    ) -> None:
        """Chooses the target angle of every steering joint for a reachable twist."""
        vx, vy, wz = twist
        for joint, i, x, y, radius in self._joints:
            joint.choose(vx - wz * y, vy + wz * x, wz, angles[i], speeds[i] * radius)

    def _steering_delay(self, dt: float | None) -> tuple[Sequence[float], float, bool]:
        """Computes how much time the steering joints need to reach their target angles.

        Returns three values:

        - For each wheel, the steering rate (rad/s) that would reach the target angle within this
          tick.
        - The number of ticks that the slowest rolling wheel needs to reach its target steering
          angle.  The number of ticks is infinite if a rolling wheel has to turn by more than
          ``_MAX_TURN_ROLLING``.
        - ``True`` if no wheel has to turn by more than ``_MAX_TURN_ROLLING``.
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
    ) -> tuple[Twist, bool]:
        """Reduces the change of the twist so that all rolling wheels can follow within one tick.

        ``ticks`` is the number of ticks in which the wheels reach their steering angles for the
        twist ``target``.  Returns two values:

        - A reachable twist between the target twist of the last tick and ``target``.
        - ``True`` if a wheel at a steering limit must turn to the opposite direction.
        """
        start, share = self._last_target, 1.0
        ratio = self._square(target) / max(self._square(start), 1e-12)
        if ratio < 1.0:  # a slower command slows the robot down even while wheels still steer
            start = start.scaled(math.sqrt(ratio))
        self._choose_angles(start, angles, speeds)
        _, start_ticks, _ = self._steering_delay(dt)
        if start_ticks >= 1.0:
            return start, False
        slower = target
        while ticks > 1.0:
            # If a steered wheel would turn too far, the loop halves the change of the twist.
            # Otherwise the loop interpolates the change of the twist that the steering joints can
            # follow within exactly one tick.
            share *= 0.5 if ticks == math.inf else (1.0 - start_ticks) / (ticks - start_ticks)
            if ticks == math.inf and share < _MIN_SHARE:
                self._choose_angles(start, angles, speeds)
                return start, True
            beyond = slower
            slower = start.towards(target, share)
            if not self._unconstrained:
                slower, limiting = self._reachable.project(slower)
                if limiting and ticks == math.inf:
                    continue  # unreachable twists separate the two motions
                if limiting:
                    # The centre of rotation must cross the circle of a contact point with trail.
                    # The projection would stay at its near edge for ever.
                    slower = beyond
            self._choose_angles(slower, angles, speeds)
            if ticks < math.inf:
                break
            _, ticks, _ = self._steering_delay(dt)
        return slower, False

    def _move_steering(self, dt: float | None) -> None:
        """Moves the steering joints towards their target angles for ``dt`` s.

        If ``dt`` is ``None``, the commanded steering angles jump to the target angles.
        """
        if dt is None:
            for joint in self._steering:
                joint.jump()
        else:
            times = [abs(j.target - j.angle) * j.seconds_per_rad for j in self._steering]
            slowest = max(times)
            # A steering joint that arrives within two ticks does not wait for the other steering
            # joints.
            together = slowest > 2.0 * dt and self.options.arrive_together
            for joint, time in zip(self._steering, times, strict=True):
                joint.advance(dt, time / slowest if together else 1.0)
        self._store_angles()

    def _store_angles(self) -> None:
        angles = list(self._zeros)
        for i, joint in self._steered:
            angles[i] = joint.angle
        self._angles = (*angles,)

    def _pushes(self) -> list[float]:
        """Returns the wheel speeds (rad/s) by which wheels roll because their joints turn.

        The contact point of a wheel with a lateral offset moves on a circle around the steering
        axis.
        """
        pushes = list(self._zeros)
        for i, joint, gain in self._pushing:
            pushes[i] = gain * joint.rate
        return self._motors.average_shared(pushes) if self._has_shared_motors else pushes

    def _misalignment(self, angles: Sequence[float]) -> float:
        """Returns the largest difference (rad) between a steering angle and its target angle.

        Returns infinity if the steering limits of a wheel exclude every suitable steering angle.
        """
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
        """Returns the wheel speeds (rad/s) at the target angles, and their common scale.

        The common scale, at most 1, is the factor by which the speed limits reduce all speeds.
        """
        speeds = list(self._zeros)
        scale = 1.0
        wz = target.wz
        for i, joint, gain, lateral, limit in self._driven_steered:
            v = joint.rolling * gain
            if lateral and not joint.unreachable:
                # A wheel with a lateral offset rolls even if its axis is at the centre of rotation.
                v -= lateral * wz
            speeds[i] = v
            if v > limit or v < -limit:
                scale = min(scale, limit / abs(v))
        if self._driven_fixed:
            scale = self._set_fixed_speeds(target, speeds, scale)
        if scale < 1.0:
            speeds = [v * scale for v in speeds]
        return self._motors.average_shared(speeds) if self._has_shared_motors else speeds, scale

    def _set_fixed_speeds(self, twist: Twist, speeds: list[float], scale: float) -> float:
        """Sets the speeds (rad/s) of the fixed wheels in ``speeds``.

        Returns the scale factor ``scale``, or a smaller factor if a fixed wheel would exceed its
        speed limit.
        """
        vx, vy, wz = self._skid.compensate(twist) if self._skid else twist
        for i, l1, l2, l3, radius, limit in self._driven_fixed:
            speeds[i] = v = (l1 * vx + l2 * vy + l3 * wz) / radius
            if v * scale > limit or v * scale < -limit:
                scale = limit / abs(v)
        return scale

    def _least_scrub(
        self,
        target: Twist,
        angles: Sequence[float],
        misalignment: float,
        pushes: Sequence[float] | None,
    ) -> tuple[Twist, list[float]]:
        """Returns the twist with the least scrub at given steering angles, and its wheel speeds.

        The wheel speeds are in rad/s.  The solver computes the difference d = xi* - target, which
        avoids rounding errors near the target twist.  With the metric G = diag(1, 1, length^2), d
        solves the linear system

            (sum T'T + lambda G) d = -sum T' (T target)

        The weight lambda grows to infinity as the largest steering error decreases to ``_ALIGNED``.
        The resulting twist is therefore a continuous function of the steering error.  The resulting
        twist is not larger than ``target``, and no wheel is faster than the fastest wheel of
        ``target``.

        - ``misalignment``: largest steering error (rad), more than ``_ALIGNED``.
        - ``pushes``: wheel speeds (rad/s) of turning steering joints, see ``_pushes``.
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
        # The target twist is feasible, so it causes no side slip on the fixed wheels.
        for t1, t2, t3 in self._fixed.rows:
            a11 += t1 * t1
            a12 += t1 * t2
            a13 += t1 * t3
            a22 += t2 * t2
            a23 += t2 * t3
            a33 += t3 * t3
        dx, dy, dw = solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)
        twist = Twist(vx + dx, vy + dy, wz + dw)
        excess = self._square(twist) / max(self._square(target), 1e-12)
        if excess > 1.0:
            twist = twist.scaled(1.0 / math.sqrt(excess))
        vx, vy, wz = twist
        speeds = list(self._zeros)
        fastest = 0.0
        for (i, joint, _, _, x, y, _, lateral, radius, driven), (c, s) in zip(
            self._scrubbing, directions, strict=True
        ):
            if not driven or joint.unreachable:
                continue
            v = -lateral * wz if lateral else 0.0
            if not joint.holding:
                v += c * (vx - wz * y) + s * (vy + wz * x)
            speeds[i] = v / radius
            if v > fastest or -v > fastest:
                fastest = abs(v)
        limit = self._fastest_wheel(target, fastest)
        if fastest > limit:
            twist, speeds = twist.scaled(limit / fastest), [v * limit / fastest for v in speeds]
        if self._driven_fixed:
            self._set_fixed_speeds(twist, speeds, 1.0)
        twist, speeds = self._motors.limit_speeds(twist, speeds, pushes)
        return twist, self._motors.average_shared(speeds)

    def _fastest_wheel(self, twist: Twist, enough: float) -> float:
        """Returns the speed (m/s) of the fastest steered wheel of ``twist`` at its target angles.

        The search ends at the first wheel with a speed of at least ``enough``.
        """
        vx, vy, wz = twist
        fastest = 0.0
        for _, joint, _, _, x, y, _, lateral, _, driven in self._scrubbing:
            if driven and not joint.unreachable:
                speed = math.hypot(vx - wz * y, vy + wz * x) + abs(lateral * wz)
                if speed >= enough:
                    return speed
                fastest = max(fastest, speed)
        return fastest

    def _rolling_twist(
        self, twist: Twist, speeds: Sequence[float], angles: Sequence[float], at_targets: bool
    ) -> Twist:
        """Returns the twist near ``twist`` that fits the wheel speeds (rad/s) best.

        An acceleration limit mixes the wheel speeds of the last tick with those of this tick.
        While wheels turn, the mixed twist does not have these wheel speeds.  With the rolling rows
        L and the rolling speeds v of all driven wheels, and with a weight epsilon of ``twist``, the
        correction d solves (sum L'L + epsilon G) d = sum L' (v - L twist).  The rolling rows are
        those of the target angles if ``at_targets`` is ``True``, else those of ``angles``.
        ``speeds`` are without ``_pushes``.
        """
        vx, vy, wz = twist
        rows = [(i, l1, l2, l3, radius) for i, l1, l2, l3, radius, _ in self._driven_fixed]
        for i, joint, heading, sign, x, y, _, lateral, radius, driven in self._scrubbing:
            if driven and not joint.holding:
                angle = joint.target if at_targets else angles[i]
                c, s = math.cos(heading + sign * angle), math.sin(heading + sign * angle)
                rows.append((i, c, s, s * x - c * y - lateral, radius))
        gaps = [
            (l1, l2, l3, speeds[i] * radius - (l1 * vx + l2 * vy + l3 * wz))
            for i, l1, l2, l3, radius in rows
        ]
        if max((abs(gap) for _, _, _, gap in gaps), default=0.0) < _SAME_SPEED:
            return twist
        dx, dy, dw = least_squares3(gaps, _KEEP_WEIGHT, _KEEP_WEIGHT * self._length2)
        return Twist(vx + dx, vy + dy, wz + dw)
