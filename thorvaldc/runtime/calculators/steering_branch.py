"""Chooses the steering angle of one wheel and moves the steering joint to the chosen angle.

If the steering axis of a wheel moves in the direction phi, each steering angle c = phi + k pi with
an integer k lets the wheel roll without side slip.  At the steering angle phi, the wheel rolls
forwards (forward branch).  At the steering angle phi + pi, the wheel rolls backwards (backward
branch).  Steering angles are not wrapped to one turn, because the motor cable limits the steering
angle.  Two steering angles that differ by a full turn are therefore different candidates.  Among
all candidates within the steering limits, the class ``SteeringJoint`` chooses the steering angle c
with the smallest cost (s):

    cost(c) = max(|c - angle| / rate, reversal of the wheel speed) + V(c) / rate + hysteresis

The hysteresis is added only to candidates for which the wheel must reverse its rolling direction.
V(c) is the expected travel of the steering joint from c to its next target angle, if the next
direction of motion is uniformly distributed.  Far from its limits, the steering joint turns by at
most pi/2, and by pi/4 on average.  If the joint is at a distance d < pi/2 from a steering limit,
the joint turns by at most d towards the limit and by at most pi - d away from the limit.  Expected
travel V of a steering joint near a limit:

    V = (1/pi) (integral of t from 0 to d + integral of t from 0 to pi - d)
      = (d^2 + (pi - d)^2) / (2 pi)

The term V(c) in the cost keeps steering joints away from their steering limits.  The mean travel of
a steering joint with this cost is within 0.3 % of the optimum.  The optimum was computed by dynamic
programming for limits of +-180 deg and independent random directions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import atan2, remainder, sqrt
from typing import Final

from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, WheelGeometry
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

PI: Final = math.pi
TWO_PI: Final = 2.0 * math.pi
_QUICK: Final = PI / 4.0

HOLD_BELOW: Final = 1e-3
"""Speed (m/s) of the steering axis below which the steering joint holds its angle."""
RESUME_ABOVE: Final = 2e-3
"""Speed (m/s) above which a steering joint that holds its angle follows the motion again."""
LIMIT_TOLERANCE: Final = 1e-9
"""A steering angle beyond a limit by at most this angle (rad) is a rounding error.

The angle is clamped to the limit.  The tolerance is larger than that of ``reachable_twists``.
"""
_HOLD2: Final = HOLD_BELOW**2
_TOUCH: Final = 1e-9
"""Share by which the motion of a contact point may miss the circle around the steering axis."""
_TIE: Final = 1e-9
"""Two costs of steering angles count as equal up to this difference (s)."""
_PUSH_SHARE: Final = 0.75
"""Share of a drive's speed and acceleration that its steering joint may demand.

A contact point beside the steering axis moves as the joint turns, and the drive must turn the wheel
along.  The rest of the drive's speed and acceleration moves the robot.
"""


class SteeringJoint:
    """The steering joint of one wheel, or of several wheels that share the joint.

    All angles are joint positions in rad and are not wrapped.

    - ``target``: chosen steering angle.
    - ``angle``, ``rate``: commanded steering angle (rad) and commanded steering rate (rad/s).
    - ``direction``: 1.0 if the wheel rolls forwards, -1.0 if the wheel rolls backwards.
    - ``rolling``: rolling speed (m/s) of the steering axis at the target angle.
    - ``holding``: ``True`` if the joint keeps its steering angle because the steering axis does not
      move, or because no candidate is within the steering limits.
    - ``unreachable``: ``True`` if no candidate is within the steering limits.
    - ``wheels``: indices of the wheels that the steering joint turns.
    - ``wheel``: geometry of the first wheel on the steering joint.
    - ``acceleration``: acceleration limit (m/s^2) of the rolling speed.
    - ``seconds_per_rad``: time (s) that the joint needs to turn by 1 rad at its full steering rate.
    """

    __slots__ = (
        "_base",
        "_has_trail",
        "_hysteresis",
        "_lower",
        "_max_rate",
        "_max_rate_change",
        "_sign",
        "_upper",
        "acceleration",
        "angle",
        "direction",
        "holding",
        "rate",
        "rolling",
        "seconds_per_rad",
        "target",
        "unreachable",
        "wheel",
        "wheels",
    )

    def __init__(
        self, geometry: Sequence[WheelGeometry], wheels: tuple[int, ...], hysteresis: float
    ) -> None:
        """Creates the joint at rest at the angle 0.

        ``geometry``: geometry of all wheels of the robot.
        """
        self.wheel = wheel = geometry[wheels[0]]
        self.wheels = wheels
        self.acceleration = min(geometry[i].max_acceleration * geometry[i].radius for i in wheels)
        self._hysteresis = hysteresis
        self._sign = wheel.sign
        self._has_trail = wheel.trail != 0.0
        self._lower = -math.inf if wheel.lower is None else wheel.lower
        self._upper = math.inf if wheel.upper is None else wheel.upper
        self._max_rate = wheel.max_rate if wheel.max_rate > 0.0 else math.inf
        self._max_rate_change = wheel.max_rate_change if wheel.max_rate_change > 0.0 else math.inf
        for w in (geometry[i] for i in wheels):
            if w.driven and w.lateral:
                follows = _PUSH_SHARE * w.radius / abs(w.lateral)
                self._max_rate = min(self._max_rate, follows * w.max_speed)
                self._max_rate_change = min(self._max_rate_change, follows * w.max_acceleration)
        self.seconds_per_rad = 1.0 / self._max_rate
        self.reset(0.0)

    def reset(self, angle: float) -> None:
        """Discards the last chosen steering angle and sets the joint to rest at ``angle`` (rad)."""
        self.angle = min(max(angle, self._lower), self._upper)
        self.target = self.angle
        self.rate = 0.0
        self._set_branch(1.0)
        self.rolling = 0.0
        self.holding = True
        self.unreachable = False

    def resume(self, previous: SteeringJoint) -> None:
        """Copies the steering angle and branch from ``previous``, an object for the same joint."""
        self.angle, self.target, self.rate = previous.angle, previous.target, previous.rate
        self._set_branch(previous.direction)
        self.rolling, self.holding = previous.rolling, previous.holding
        self.unreachable = previous.unreachable

    def _set_branch(self, direction: float) -> None:
        """Sets the rolling direction of the wheel: 1.0 for forwards, -1.0 for backwards."""
        self.direction = direction
        # Steering angle at which the wheel moves along the x axis of base_link with this rolling
        # direction.
        self._base = -self._sign * self.wheel.heading + (PI if direction < 0.0 else 0.0)

    def expected_travel(self, angle: float) -> float:
        """Returns the expected travel V (rad) of the joint from ``angle`` to its next target.

        The formula for the expected travel V is derived in the documentation of the module
        ``steering_branch``.
        """
        travel = PI / 4.0
        for d in (angle - self._lower, self._upper - angle):
            if d < PI / 2.0:
                d = max(d, 0.0)
                travel += (d * d + (PI - d) * (PI - d)) / TWO_PI - PI / 4.0
        return travel

    def choose(self, ux: float, uy: float, wz: float, angle: float, speed: float) -> None:
        """Chooses ``target`` and ``direction`` for the velocity of the steering axis.

        - ``ux``, ``uy``: velocity (m/s) of the steering axis in ``base_link``.
        - ``wz``: yaw rate (rad/s) of the robot.
        - ``angle``: present steering angle (rad).
        - ``speed``: present rolling speed (m/s) of the wheel.

        The target angle does not change if the robot stands still, if the steering axis is at the
        centre of rotation, or if no candidate is within the steering limits.
        """
        if not (self.holding or self._has_trail):
            # Fast path: a candidate with the present rolling direction is always the best if it is
            # within 45 deg of the present steering angle.
            v2 = ux * ux + uy * uy
            turn = self._base + self._sign * atan2(uy, ux) - angle
            if not -_QUICK < turn < _QUICK:
                turn = remainder(turn, TWO_PI)
            target = angle + turn
            if (
                -_QUICK < turn < _QUICK
                and self._lower <= target <= self._upper
                and v2 >= _HOLD2
                and self.direction * speed >= 0.0
            ):
                self.target = target
                self.rolling = self.direction * sqrt(v2)
                self.unreachable = False
                return
        self._search(ux, uy, wz, angle, speed)

    def _search(self, ux: float, uy: float, wz: float, angle: float, speed: float) -> None:
        """Chooses the steering angle with the smallest cost among all angles within the limits."""
        v = math.hypot(ux, uy)
        self.unreachable = False
        bend = wz * self.wheel.trail
        if v < (RESUME_ABOVE if self.holding else HOLD_BELOW) or abs(bend) > v * (1.0 + _TOUCH):
            self.holding = True
            self.rolling = 0.0
            return
        # The contact point lies at the distance `trail` ahead of the steering axis, in the wheel's
        # direction theta.  The contact point has no side slip if v sin(phi - theta) + wz trail = 0.
        # One solution is theta = phi + asin(wz trail / v).  With the other solution, theta = phi +
        # pi - asin(wz trail / v), the wheel rolls backwards.
        phi = math.atan2(uy, ux) - self.wheel.heading
        lead = math.asin(max(-1.0, min(1.0, bend / v))) if bend else 0.0
        sign = self.wheel.sign
        lower, upper = self._lower, self._upper
        # For a steering joint without limits, the best steering angle is at most one full turn
        # away.
        first = max(lower - LIMIT_TOLERANCE, angle - TWO_PI)
        last = min(upper + LIMIT_TOLERANCE, angle + TWO_PI)
        rate = self._max_rate if self._max_rate < math.inf else 1.0
        # Between free_low and free_high, the steering joint can make a quarter turn to both sides,
        # so the expected travel V is pi/4.
        free_low, free_high = lower + PI / 2.0, upper - PI / 2.0
        best_cost, best_angle, best_direction = math.inf, 0.0, 0.0
        for direction, base in ((1.0, sign * (phi + lead)), (-1.0, sign * (phi - lead + PI))):
            # A wheel that rolls in the opposite direction must first reverse its wheel speed.
            opposite = -direction * speed
            reversal = 2.0 * opposite / self.acceleration if opposite > 0.0 else 0.0
            hysteresis = 0.0 if direction == self.direction else self._hysteresis
            c = base + TWO_PI * math.ceil((first - base) / TWO_PI) - TWO_PI
            for _ in range(3):  # at most three candidates lie within a turn to each side
                c += TWO_PI
                if c > last:
                    break
                at = lower if c < lower else min(c, upper)
                cost = abs(at - angle) / rate
                if cost < reversal:
                    cost = reversal
                next_travel = PI / 4.0 if free_low <= at <= free_high else self.expected_travel(at)
                cost += next_travel / rate + hysteresis
                if cost > best_cost + _TIE:
                    continue
                if cost >= best_cost - _TIE and not self._preferred(
                    at, direction, best_angle, best_direction
                ):
                    continue
                best_cost, best_angle, best_direction = cost, at, direction
        if best_direction == 0.0:
            self.holding = True
            self.unreachable = True
            self.rolling = 0.0
            return
        self.holding = False
        self.target = best_angle
        self._set_branch(best_direction)
        self.rolling = best_direction * v * math.cos(lead)

    def _preferred(
        self, angle: float, direction: float, best_angle: float, best_direction: float
    ) -> bool:
        """Checks whether a steering angle is better than the best one so far, at equal cost.

        Of two steering angles with equal cost, the angle that keeps the rolling direction is
        better, then the smaller absolute angle, then the positive angle.
        """
        candidate = (direction != self.direction, abs(angle), -angle)
        best = (best_direction != self.direction, abs(best_angle), -best_angle)
        return candidate < best

    def advance(self, dt: float, share: float) -> None:
        """Moves the commanded steering angle towards the target for ``dt`` s, without overshoot.

        ``share`` is the allowed share of the steering joint's rate limit, 0 to 1. The acceleration
        limit of the steering joint is respected.
        """
        error = self.target - self.angle
        if error == 0.0 and self.rate == 0.0:
            return
        change = self._max_rate_change * dt
        slower, faster = self.rate - change, self.rate + change
        needed = error / dt
        limit = self._max_rate * share
        if -change <= needed <= change and slower <= needed <= faster and -limit <= needed <= limit:
            self.angle = self.target
            self.rate = needed
            return
        fastest = abs(needed)
        if change < fastest:
            # stopping_rate is the highest rate w from which the joint still stops at the target.
            # While the rate decreases by `change` in each tick, the joint travels w^2 / (2
            # rate_change) + w dt / 2.  The travel is up to change dt / 8 longer if w is not a
            # multiple of `change`.
            distance = abs(error) - change * dt / 8.0
            square = change * change / 4.0 + 2.0 * self._max_rate_change * distance
            stopping_rate = sqrt(square) - change / 2.0
            if stopping_rate < change:
                stopping_rate = change
            if stopping_rate < fastest:
                fastest = stopping_rate
        if fastest > limit:
            fastest = limit
        rate = fastest if error > 0.0 else -fastest
        if rate > faster:
            rate = faster
        elif rate < slower:
            rate = slower
        angle = self.angle + rate * dt
        if -1e-9 < self.target - angle < 1e-9:
            angle = self.target
        if self._lower <= angle <= self._upper:
            self.angle = angle
            self.rate = rate
        else:
            self.angle = self._lower if angle < self._lower else self._upper
            self.rate = 0.0

    def jump(self) -> None:
        """Sets the commanded steering angle to the target angle and ignores the rate limit."""
        self.angle = self.target
        self.rate = 0.0

    def brake(self, dt: float) -> None:
        """Lets the commanded steering angle come to rest within its acceleration, in ``dt`` s."""
        change = self._max_rate_change * dt
        self.rate -= min(max(self.rate, -change), change)
        self.angle = min(max(self.angle + self.rate * dt, self._lower), self._upper)
        self.target = self.angle


# -- limits of the drive motors -----------------------------------------------------------------
#
# All wheel speeds are scaled by the same factor, so that the direction of the twist and the centre
# of rotation do not change.  A wheel with a lateral offset also rolls while its steering joint
# turns, although the robot stands.  This part of a wheel speed is not scaled, because a drive that
# lags behind its steering joint would move the robot.


class DriveMotors:
    """Limits the wheel speeds of the drive motors and stores the last command.

    The stored command consists of the speed of each wheel (rad/s) and of the resulting twist.

    - ``rolling_speeds``: last commanded speeds (rad/s) without the speeds that turning steering
      joints add.
    - ``has_commanded``: false until the first command, when the wheels may have any speed.
    """

    def __init__(self, geometry: BaseGeometry) -> None:
        self._limits = tuple(
            (i, w.max_speed, w.max_acceleration)
            for i, w in enumerate(geometry.wheels)
            if w.driven and not w.swivel
        )
        self._encoders = tuple(i for i, w in enumerate(geometry.wheels) if w.encoder)
        self._shared = geometry.spin_groups
        self._zeros = (0.0,) * len(geometry.wheels)
        self.has_commanded = False
        self.reset()

    def reset(self) -> None:
        """Lets all drive motors start from rest."""
        self._speeds: tuple[float, ...] = self._zeros
        self.rolling_speeds: Sequence[float] = self._zeros
        self._pushes: Sequence[float] = self._zeros
        self.twist = ZERO_TWIST

    def resume(self, previous: DriveMotors) -> None:
        """Copies the last commanded wheel speeds and twist from ``previous``."""
        self.has_commanded = previous.has_commanded
        self._speeds, self._pushes = previous._speeds, previous._pushes
        self.rolling_speeds, self.twist = previous.rolling_speeds, previous.twist

    @property
    def commanded_speeds(self) -> Sequence[float]:
        """Last commanded wheel speeds, rad/s."""
        return self._speeds

    def brake(
        self,
        dt: float,
        decelerations: tuple[float, float],
        measured: JointStates | None,
        pushes: Sequence[float] | None,
    ) -> None:
        """Moves the last command towards rest for ``dt`` s, the only place where a stop proceeds.

        With the last commanded speeds w, their twist (v, wz), the decelerations (a, alpha) of the
        robot and the accelerations b of the motors, the wheels reach rest together after

            T = max(|v| / a, |wz| / alpha, max |w_i| / b_i)

        and all commands shrink to the share 1 - dt / T of the last ones.  The command of a wheel
        that turns more slowly in ``measured`` is the measured speed; a wheel that turns faster, or
        backwards, raises and reverses nothing.  ``pushes``: part of the speeds (rad/s) that the
        steering joints, which still turn, ask for; a later command goes on from it.
        """
        self.has_commanded = True
        twist, speeds = self.twist, self._speeds
        time = max(twist.speed / decelerations[0], abs(twist.wz) / decelerations[1])
        for i, _, acceleration in self._limits:
            time = max(time, abs(speeds[i]) / acceleration)
        share = 1.0 - dt / time if dt < time else 0.0
        braked = [share * v for v in speeds]
        if measured is not None:
            for i in self._encoders:
                v, m = braked[i], measured.speeds[i]
                braked[i] = min(v, max(m, 0.0)) if v > 0.0 else max(v, min(m, 0.0))
            share = max((b / v for b, v in zip(braked, speeds, strict=True) if v), default=0.0)
        self.reset()
        if any(braked):
            self._speeds, self.twist = (*braked,), twist.scaled(share)
        self._pushes = pushes or self._zeros
        self.rolling_speeds = [v - p for v, p in zip(self._speeds, self._pushes, strict=True)]

    def average_shared(self, speeds: list[float]) -> list[float]:
        """Sets the speeds of wheels that share a drive motor to their mean speed, in place."""
        for group in self._shared:
            mean = float_sum(speeds[i] for i in group) / len(group)
            for i in group:
                speeds[i] = mean
        return speeds

    def limit_speeds(
        self, twist: Twist, speeds: list[float], pushes: Sequence[float] | None = None
    ) -> tuple[Twist, list[float]]:
        """Scales all wheel speeds and the twist so that no wheel exceeds its speed limit.

        ``pushes``: speeds (rad/s) that ``limit_accelerations`` adds later, because steering joints
        turn.
        """
        scale = 1.0
        for i, limit, _ in self._limits:
            v = speeds[i]
            if pushes and pushes[i]:
                limit -= pushes[i] if v > 0.0 else -pushes[i]
            if v * scale > limit or v * scale < -limit:
                scale = max(limit, 0.0) / abs(v)
        if scale < 1.0:
            return twist.scaled(scale), [v * scale for v in speeds]
        return twist, speeds

    def limit_accelerations(
        self,
        twist: Twist,
        speeds: Sequence[float],
        dt: float | None,
        pushes: Sequence[float] | None = None,
    ) -> tuple[Twist, tuple[float, ...]]:
        """Limits the change of the wheel speeds and the twist during the next ``dt`` s.

        The limited wheel speeds are v0 + k (v - v0), where v0 are the last commanded speeds and v
        are the requested speeds.  The share k <= 1 of the change is as large as the acceleration
        limits of all wheels allow.  The twist changes by the same share k as the wheel speeds.  If
        ``dt`` is ``None``, the change of the wheel speeds is not limited.  ``pushes`` are speeds
        (rad/s) of wheels with a lateral offset while their steering joints turn.  They are added to
        the limited wheel speeds.  The limited twist and wheel speeds are returned and stored as the
        last command.
        """
        pushes = pushes or self._zeros
        if dt is not None:
            last_speeds, last_pushes = self.rolling_speeds, self._pushes
            pushed = pushes is not last_pushes
            share = 1.0
            for i, _, acceleration in self._limits:
                change = speeds[i] - last_speeds[i]
                max_change = acceleration * dt
                if pushed:
                    push = pushes[i] - last_pushes[i]
                    max_change = max(max_change - (push if change > 0.0 else -push), 0.0)
                if change * share > max_change or change * share < -max_change:
                    share = max_change / abs(change)
            if share < 1.0:
                speeds = [u + share * (v - u) for v, u in zip(speeds, last_speeds, strict=True)]
                twist = self.twist.towards(twist, share)
        self.has_commanded = True
        self.twist, self.rolling_speeds, self._pushes = twist, speeds, pushes
        if pushes is not self._zeros:
            speeds = [v + p for v, p in zip(speeds, pushes, strict=True)]
        self._speeds = (*speeds,)
        return twist, self._speeds
