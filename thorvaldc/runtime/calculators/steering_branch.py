"""One steered wheel: which of its angles to take, and how fast to get there."""

from __future__ import annotations

import math
from math import atan2, remainder, sqrt

from thorvaldc.runtime.calculators.base_geometry import WheelGeometry

PI = math.pi
TWO_PI = 2.0 * math.pi
_QUICK = PI / 4.0

HOLD_BELOW = 1e-3
"""Speed (m/s) of a wheel's place below which it has no direction worth following."""
RESUME_ABOVE = 2e-3
LIMIT_TOLERANCE = 1e-4
"""How far (rad) past a limit an angle may be asked for; it is then clamped to the limit."""
_HOLD2 = HOLD_BELOW**2
_TIE = 1e-9


class Steering:
    """The steering joint of one wheel (or of wheels that share it).

    Remembers the angle last chosen and commanded, the branch (``direction``:
    1.0 forward, -1.0 rolling backwards) and whether it holds; ``rolling`` (m/s) is
    the speed along the wheel that the axis has at the target angle.  All angles are
    joint positions in rad, linear and never wrapped: a cable limits the joint.
    """

    __slots__ = (
        "_base",
        "_bends",
        "_hysteresis",
        "_lower",
        "_max_rate",
        "_max_rate_change",
        "_sign",
        "_upper",
        "acceleration",
        "angle",
        "direction",
        "held",
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
        self._bends = wheel.trail != 0.0
        self._lower = -math.inf if wheel.lower is None else wheel.lower
        self._upper = math.inf if wheel.upper is None else wheel.upper
        self._max_rate = wheel.max_rate if wheel.max_rate > 0.0 else math.inf
        self._max_rate_change = wheel.max_rate_change if wheel.max_rate_change > 0.0 else math.inf
        self.seconds_per_rad = 1.0 / self._max_rate
        self.reset(0.0)

    def reset(self, angle: float) -> None:
        """Start afresh with the joint at rest at ``angle``."""
        self.angle = min(max(angle, self._lower), self._upper)
        self.target = self.angle
        self.rate = 0.0
        self._take(1.0)
        self.rolling = 0.0
        self.held = True
        self.unreachable = False

    def resume(self, before: Steering) -> None:
        """Go on from where another for the same joint is."""
        self.angle, self.target, self.rate = before.angle, before.target, before.rate
        self._take(before.direction)
        self.rolling, self.held = before.rolling, before.held
        self.unreachable = before.unreachable

    def _take(self, direction: float) -> None:
        """Be on that branch: forward (1.0) or backwards (-1.0)."""
        self.direction = direction
        # The joint's angle at which the wheel on this branch moves along base_link's x.
        self._base = -self._sign * self.wheel.heading + (PI if direction < 0.0 else 0.0)

    def expected_travel(self, angle: float) -> float:
        """Mean travel (rad) from ``angle`` to the next direction, all being alike.

        pi/4 where a quarter turn is free on both sides; beyond a limit d away
        the joint must go the other way round: (d^2 + (pi - d)^2) / (2 pi).
        """
        travel = PI / 4.0
        for d in (angle - self._lower, self._upper - angle):
            if d < PI / 2.0:
                d = max(d, 0.0)
                travel += (d * d + (PI - d) * (PI - d)) / TWO_PI - PI / 4.0
        return travel

    def choose(self, ux: float, uy: float, wz: float, angle: float, speed: float) -> None:
        """Choose ``target`` and ``direction`` for the velocity of the steering axis.

        ``ux``, ``uy`` (m/s) and ``wz`` (rad/s) are those of the robot at the
        axis, in ``base_link``; ``angle`` (rad) and ``speed`` (m/s, rolling) are
        the wheel's now.  Of all angles at which the contact does not slip
        sideways and which lie within the limits, it takes the one that is
        reached first, counting what the next change is expected to cost.
        At standstill, with the axis at the centre of rotation and where no
        angle can be reached, the target stays.
        """
        if not (self.held or self._bends):
            # An eighth of a turn on the branch it is on: no other angle can be better.
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
        """Choose among all angles within the limits."""
        v = math.hypot(ux, uy)
        self.unreachable = False
        bend = wz * self.wheel.trail
        if v < (RESUME_ABOVE if self.held else HOLD_BELOW) or abs(bend) >= v:
            self.held = True
            self.rolling = 0.0
            return
        # Side slip at the contact: v sin(phi - theta) + wz trail = 0.
        phi = math.atan2(uy, ux) - self.wheel.heading
        lead = math.asin(bend / v) if bend else 0.0
        sign = self.wheel.sign
        lower, upper = self._lower, self._upper
        # An unlimited joint: one turn to each side has all there is.
        first = max(lower - LIMIT_TOLERANCE, angle - TWO_PI)
        last = min(upper + LIMIT_TOLERANCE, angle + TWO_PI)
        rate = self._max_rate if self._max_rate < math.inf else 1.0
        # Between these a quarter turn is free on both sides.
        easy_low, easy_high = lower + PI / 2.0, upper - PI / 2.0
        best_cost, best_angle, best_direction, past = math.inf, 0.0, 0.0, 0.0
        for direction, base in ((1.0, sign * (phi + lead)), (-1.0, sign * (phi - lead + PI))):
            back = -direction * speed
            reversal = 2.0 * back / self.acceleration if back > 0.0 else 0.0
            stay = 0.0 if direction == self.direction else self._hysteresis
            c = base + TWO_PI * math.ceil((first - base) / TWO_PI) - TWO_PI
            for _ in range(3):  # no more lie within a turn to each side
                c += TWO_PI
                if c > last:
                    break
                at = lower if c < lower else min(c, upper)
                missed = c - at
                cost = abs(at - angle) / rate
                if cost < reversal:
                    cost = reversal
                next_travel = PI / 4.0 if easy_low <= at <= easy_high else self.expected_travel(at)
                cost += next_travel / rate + stay
                if cost > best_cost + _TIE:
                    continue
                if cost >= best_cost - _TIE and not self._preferred(
                    at, direction, best_angle, best_direction
                ):
                    continue
                best_cost, best_angle, best_direction, past = cost, at, direction, missed
        if best_direction == 0.0:
            self.held = True
            self.unreachable = True
            self.rolling = 0.0
            return
        self.held = False
        self.target = best_angle
        self._take(best_direction)
        if bend or past:
            v *= math.cos(lead - best_direction * sign * past)
        self.rolling = best_direction * v

    def _preferred(self, angle: float, direction: float, other: float, its: float) -> bool:
        """Of two angles of equal cost: the branch it is on, the smaller, forward, positive."""
        one = (direction != self.direction, abs(angle), -direction, -angle)
        two = (its != self.direction, abs(other), -its, -other)
        return one < two

    def time_to_target(self) -> float:
        """Time (s) to the target at full rate."""
        return abs(self.target - self.angle) * self.seconds_per_rad

    def advance(self, dt: float, share: float) -> None:
        """Move the commanded ``angle`` towards the target for ``dt`` s.

        Within ``share`` of the joint's rate and within its rate of change,
        without overshoot.
        """
        error = self.target - self.angle
        if error == 0.0 and self.rate == 0.0:
            return
        change = self._max_rate_change * dt
        slower, faster = self.rate - change, self.rate + change
        wanted = error / dt
        top = self._max_rate * share
        if -change <= wanted <= change and slower <= wanted <= faster and -top <= wanted <= top:
            self.angle = self.target
            self.rate = wanted
            return
        fastest = abs(wanted)
        if change < fastest:
            # The rate from which the joint still stops at the target, braking in whole
            # ticks, of which the last is a partial one.
            left = abs(error) - change * dt / 8.0
            stop = sqrt(change * change / 4.0 + 2.0 * self._max_rate_change * left) - change / 2.0
            if stop < change:
                stop = change
            if stop < fastest:
                fastest = stop
        if fastest > top:
            fastest = top
        rate = fastest if error > 0.0 else -fastest
        if rate > faster:
            rate = faster
        elif rate < slower:
            rate = slower
        after = self.angle + rate * dt
        if -1e-9 < self.target - after < 1e-9:
            after = self.target
        if self._lower <= after <= self._upper:
            self.angle = after
            self.rate = rate
        else:
            self.angle = self._lower if after < self._lower else self._upper
            self.rate = 0.0

    def jump(self) -> None:
        """Command the target at once."""
        self.angle = self.target
        self.rate = 0.0
