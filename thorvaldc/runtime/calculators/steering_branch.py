"""Choice of the steering angle of one wheel, and its motion to that angle.

A wheel whose axis moves in the direction phi can stand at any angle c = phi + k pi: it rolls
forwards for even k (the *forward branch*) and backwards for odd k.  A cable limits the joint, so
angles are not wrapped, and c, c + 2 pi are two different candidates.  Among all candidates within
the limits, ``SteeringJoint`` takes the one of least cost, in seconds:

    cost(c) = max(|c - angle| / rate, reversal of the wheel speed) + V(c) / rate + hysteresis

The hysteresis counts on a change of branch.  V is the expected travel to the *next* candidate,
if the next direction of motion is uniformly distributed: with both sides free, the joint turns to
the nearer of two opposite directions, by at most pi/2, on average pi/4.  With a limit at a distance
d < pi/2 on one side, it turns by at most d to that side and by at most pi - d to the other, so

    V = (1/pi) (integral of t from 0 to d + integral of t from 0 to pi - d)
      = (d^2 + (pi - d)^2) / (2 pi)

V keeps joints away from their limits: the mean travel is within 0.3 % of the optimum by dynamic
programming (limits +-180 deg, independent random directions).
"""

from __future__ import annotations

import math
from math import atan2, remainder, sqrt

from thorvaldc.runtime.calculators.base_geometry import WheelGeometry

PI = math.pi
TWO_PI = 2.0 * math.pi
_QUICK = PI / 4.0

HOLD_BELOW = 1e-3
"""Speed (m/s) of the steering axis below which the joint holds its angle."""
RESUME_ABOVE = 2e-3
"""Speed (m/s) above which a joint that holds its angle follows the motion again."""
LIMIT_TOLERANCE = 1e-4
"""Distance (rad) past a limit up to which a candidate is clamped to the limit."""
_HOLD2 = HOLD_BELOW**2
_TIE = 1e-9
"""Costs (s) that differ by less are equal."""


class SteeringJoint:
    """The steering joint of one wheel, or of several wheels that share it.

    Angles are joint positions in rad, not wrapped.  ``target``: the chosen angle.  ``angle`` and
    ``rate``: as commanded.  ``direction``: the branch, 1.0 forward, -1.0 backwards.  ``rolling``
    (m/s): rolling speed of the axis at the target angle.  ``holding``: the joint keeps its angle,
    because the axis does not move or no candidate is reachable (``unreachable``).
    ``wheels``: indices of the wheels on the joint; ``wheel`` is the first of them.
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
        self, wheel: WheelGeometry, wheels: tuple[int, ...], max_accel: float, hysteresis: float
    ) -> None:
        self.wheel = wheel
        self.wheels = wheels
        self.acceleration = max_accel
        self._hysteresis = hysteresis
        self._sign = wheel.sign
        self._has_trail = wheel.trail != 0.0
        self._lower = -math.inf if wheel.lower is None else wheel.lower
        self._upper = math.inf if wheel.upper is None else wheel.upper
        self._max_rate = wheel.max_rate if wheel.max_rate > 0.0 else math.inf
        self._max_rate_change = wheel.max_rate_change if wheel.max_rate_change > 0.0 else math.inf
        self.seconds_per_rad = 1.0 / self._max_rate
        self.reset(0.0)

    def reset(self, angle: float) -> None:
        """Forgets the last choice; the joint rests at ``angle``."""
        self.angle = min(max(angle, self._lower), self._upper)
        self.target = self.angle
        self.rate = 0.0
        self._set_branch(1.0)
        self.rolling = 0.0
        self.holding = True
        self.unreachable = False

    def resume(self, previous: SteeringJoint) -> None:
        """Takes over the state of ``previous``, an object for the same joint."""
        self.angle, self.target, self.rate = previous.angle, previous.target, previous.rate
        self._set_branch(previous.direction)
        self.rolling, self.holding = previous.rolling, previous.holding
        self.unreachable = previous.unreachable

    def _set_branch(self, direction: float) -> None:
        """Sets the branch: forward (1.0) or backwards (-1.0)."""
        self.direction = direction
        # Joint angle at which a wheel on this branch moves along the x axis of base_link.
        self._base = -self._sign * self.wheel.heading + (PI if direction < 0.0 else 0.0)

    def expected_travel(self, angle: float) -> float:
        """Returns V (rad) of the module's documentation: the mean travel to the next candidate."""
        travel = PI / 4.0
        for d in (angle - self._lower, self._upper - angle):
            if d < PI / 2.0:
                d = max(d, 0.0)
                travel += (d * d + (PI - d) * (PI - d)) / TWO_PI - PI / 4.0
        return travel

    def choose(self, ux: float, uy: float, wz: float, angle: float, speed: float) -> None:
        """Chooses ``target`` and ``direction`` for the velocity of the steering axis.

        ``ux``, ``uy`` (m/s), ``wz`` (rad/s): velocity of the robot at the axis, in ``base_link``.
        ``angle`` (rad) and ``speed`` (m/s, rolling): the present state of the wheel.  At
        standstill, with the axis at the centre of rotation, and without a reachable candidate,
        the target does not change.
        """
        if not (self.holding or self._has_trail):
            # A candidate within 45 deg on the present branch: no other one can be better.
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
        """Chooses among all candidates within the limits."""
        v = math.hypot(ux, uy)
        self.unreachable = False
        bend = wz * self.wheel.trail
        if v < (RESUME_ABOVE if self.holding else HOLD_BELOW) or abs(bend) >= v:
            self.holding = True
            self.rolling = 0.0
            return
        # No side slip at the contact, which lies `trail` from the axis along the wheel's direction
        # theta: v sin(phi - theta) + wz trail = 0, so theta = phi + asin(wz trail / v), or the
        # other solution theta = phi + pi - asin(wz trail / v), rolling backwards.
        phi = math.atan2(uy, ux) - self.wheel.heading
        lead = math.asin(bend / v) if bend else 0.0
        sign = self.wheel.sign
        lower, upper = self._lower, self._upper
        # A joint without limits: one turn to each side contains the best candidate.
        first = max(lower - LIMIT_TOLERANCE, angle - TWO_PI)
        last = min(upper + LIMIT_TOLERANCE, angle + TWO_PI)
        rate = self._max_rate if self._max_rate < math.inf else 1.0
        # Between these angles a quarter turn is free on both sides: V = pi/4.
        free_low, free_high = lower + PI / 2.0, upper - PI / 2.0
        best_cost, best_angle, best_direction, excess = math.inf, 0.0, 0.0, 0.0
        for direction, base in ((1.0, sign * (phi + lead)), (-1.0, sign * (phi - lead + PI))):
            # A wheel that rolls the other way has to reverse its speed.
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
                best_cost, best_angle, best_direction, excess = cost, at, direction, c - at
        if best_direction == 0.0:
            self.holding = True
            self.unreachable = True
            self.rolling = 0.0
            return
        self.holding = False
        self.target = best_angle
        self._set_branch(best_direction)
        if bend or excess:
            v *= math.cos(lead - best_direction * sign * excess)
        self.rolling = best_direction * v

    def _preferred(
        self, angle: float, direction: float, best_angle: float, best_direction: float
    ) -> bool:
        """Decides between a candidate and the best one so far, at equal cost.

        Order: the present branch, the smaller absolute angle, forward, positive.
        """
        candidate = (direction != self.direction, abs(angle), -direction, -angle)
        best = (best_direction != self.direction, abs(best_angle), -best_direction, -best_angle)
        return candidate < best

    def time_to_target(self) -> float:
        """Returns the time (s) to the target at full rate."""
        return abs(self.target - self.angle) * self.seconds_per_rad

    def advance(self, dt: float, share: float) -> None:
        """Moves the commanded ``angle`` towards the target for ``dt`` s, without overshoot.

        The rate is at most ``share`` of the joint's limit and changes by at most its rate change.
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
            # The highest rate w from which the joint still stops at the target.  It brakes by
            # `change` per tick over w^2 / (2 rate_change) + w dt / 2, and up to change dt / 8 more
            # if w is not a multiple of `change`.
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
        """Commands the target angle without regard to rates."""
        self.angle = self.target
        self.rate = 0.0
