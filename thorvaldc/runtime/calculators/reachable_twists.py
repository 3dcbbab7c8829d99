"""Replaces a commanded twist by a twist that fixed wheels and steering limits allow.

A steered wheel rolls without side slip if its side-slip row (see ``WheelGeometry.rows``) satisfies
T(c) xi = 0 for a steering angle c within its limits.  A twist xi is reachable if each steered wheel
has such an angle, rolling forwards or backwards, and if no fixed wheel slips.  The limits do not
depend on the speed, so the set of reachable twists is a double cone: with xi it contains a xi for
every number a.  The scale of the speed limits therefore does not change whether a twist is
reachable.

A reachable twist does not change.  Another twist xi = e + w W consists of its translation e and
its rotation w W.  W is the twist of 1 rad/s with the velocity that a fixed axle requires.  Without
fixed wheels, W = (0, 0, 1).  Candidates for the reachable twist:

- **wider turn**: e + k W with the largest reachable k between 0 and w.  The robot keeps its speed
  and turns as tightly as it can.
- **slower turn**: s e + w W with the largest reachable s between 0 and 1.  The robot keeps its yaw
  rate.  Robots that can turn on the spot need this candidate for tight turns.
- **other direction**: if no wider turn is reachable, the velocity turns by the smallest angle d at
  which a rotation between 0 and w is reachable.  The speed is multiplied by cos(2 d).  It is zero
  from 45 deg on, where the robot would move more across the commanded direction than along it.

On the straight line of the twists e + k W, the limits of a wheel exclude two open intervals.  At
the end of such an interval, the wheel is at a steering limit, T(limit) (e + k W) = 0, or the centre
of rotation is on the circle of the contact points of a wheel with trail, |u| = |trail wz| for the
velocity u of the steering axis.  These equations have one or two solutions k, and one of the
solutions is the nearest reachable twist on this line.  In the other direction, one wheel is at a
limit with the rotation 0 or w, or two wheels are at their limits: xi is the cross product of their
side-slip rows.

The nearest of the candidates is used.  It is in general not the nearest reachable twist: that one
would let a car drive when it is to turn on the spot, and drive faster than commanded in a tight
turn.  ``bench.nearest_twist`` compares both.

With respect to the feasible twist of the fixed wheels, no candidate moves or turns faster than
commanded, or in the opposite direction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels, WheelGeometry
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_TOLERANCE: Final = 1e-10
"""A steering angle beyond a limit by at most this angle (rad) counts as within the limit."""
_LARGEST_DEVIATION: Final = math.pi / 4.0
"""Angle (rad) to the commanded velocity from which on the robot does not move."""
_KEEP: Final = 0.1
"""A candidate must be nearer by this share of the commanded twist if wheels must turn around."""

Row = tuple[float, float, float]


class _LimitedWheel:
    """The steering limits of a wheel as a condition on the twist."""

    __slots__ = (
        "_heading",
        "_lower",
        "_sign",
        "_upper",
        "_without_trail",
        "_x",
        "_y",
        "middle",
        "rows",
        "trail",
    )

    def __init__(self, wheel: WheelGeometry) -> None:
        self._x, self._y, self.trail = wheel.x, wheel.y, wheel.trail
        self._heading, self._sign = wheel.heading, wheel.sign
        self._lower = -math.inf if wheel.lower is None else wheel.lower - _TOLERANCE
        self._upper = math.inf if wheel.upper is None else wheel.upper + _TOLERANCE
        limits = [limit for limit in (wheel.lower, wheel.upper) if limit is not None]
        self.rows: list[Row] = [wheel.rows(limit)[1] for limit in limits]
        self._without_trail = not wheel.trail and len(limits) == 2
        # Rolling row at the middle of the steering range.
        self.middle: Row | None = None
        if len(limits) == 2 and limits[1] - limits[0] <= math.pi + 2.0 * _TOLERANCE:
            self.middle = wheel.rows((limits[0] + limits[1]) / 2.0)[0]

    @staticmethod
    def is_limited(wheel: WheelGeometry) -> bool:
        """Returns ``False`` if a wheel can roll at every twist without side slip."""
        if wheel.trail:
            return True
        if wheel.lower is None or wheel.upper is None:
            return False
        return wheel.upper - wheel.lower < math.pi - 2.0 * _TOLERANCE

    def velocity(self, twist: Sequence[float]) -> tuple[float, float]:
        """Returns the velocity (m/s) of the steering axis."""
        vx, vy, wz = twist
        return vx - wz * self._y, vy + wz * self._x

    def allows(self, twist: Sequence[float]) -> bool:
        """Checks whether a steering angle within the limits prevents side slip."""
        if self._without_trail:
            # The side slip has opposite signs at the two limits, so it is zero between them.
            (ax, ay, aw), (bx, by, bw) = self.rows
            vx, vy, wz = twist
            if (ax * vx + ay * vy + aw * wz) * (bx * vx + by * vy + bw * wz) <= 0.0:
                return True
        ux, uy = self.velocity(twist)
        bend = twist[2] * self.trail
        lead = 0.0
        if bend:
            speed = math.hypot(ux, uy)
            if abs(bend) > speed * (1.0 + 1e-12):
                return False
            lead = math.asin(max(-1.0, min(1.0, bend / speed)))
        elif ux == 0.0 == uy:
            return True
        direction = math.atan2(uy, ux) - self._heading
        for angle in (self._sign * (direction + lead), self._sign * (direction - lead + math.pi)):
            # The smallest equivalent of the angle that is not below the lower limit.
            if self._lower == -math.inf:
                return True
            turns = math.ceil((self._lower - angle) / math.tau)
            if angle + turns * math.tau <= self._upper:
                return True
        return False

    def tangents(self, start: Sequence[float], step: Sequence[float]) -> Iterator[float]:
        """Returns the numbers k at which start + k step turns about the circle of the contact."""
        if not self.trail:
            return
        ax, ay = self.velocity(start)
        bx, by = self.velocity(step)
        # |a + k b|^2 = (trail (start_w + k step_w))^2
        p, q = self.trail * start[2], self.trail * step[2]
        square, half = bx * bx + by * by - q * q, ax * bx + ay * by - p * q
        constant = ax * ax + ay * ay - p * p
        if abs(square) < 1e-15:
            if half:
                yield -constant / (2.0 * half)
            return
        root = half * half - square * constant
        if root >= 0.0:
            yield (-half + math.sqrt(root)) / square
            yield (-half - math.sqrt(root)) / square


class Projection(NamedTuple):
    """A reachable twist, and the indices of the wheels whose limits exclude the commanded one."""

    twist: Twist
    limiting: tuple[int, ...]


class ReachableTwists:
    """The twists that the fixed wheels and the steering limits of a robot allow.

    The documentation of the module ``reachable_twists`` contains the derivation.  Two reachable
    twists can be equally near to a commanded twist, and the robot must stop to change from one
    to the other.  The method ``project`` therefore prefers twists for which no wheel must turn
    around, starting from the twist of the last call of ``keep``.
    """

    def __init__(self, geometry: BaseGeometry, fixed: FixedWheels) -> None:
        self._fixed = fixed
        self._length = geometry.length
        self._wheels = tuple(
            (group, _LimitedWheel(geometry.wheels[group[0]]))
            for group in geometry.steering_groups
            if _LimitedWheel.is_limited(geometry.wheels[group[0]])
        )
        self._rows = tuple(row for _, wheel in self._wheels for row in wheel.rows)
        self.unlimited = not self._wheels
        self._unconstrained = fixed.unconstrained
        rotation = fixed.feasible(Twist(0.0, 0.0, 1.0))
        self._rotation: Row = (rotation.vx, rotation.vy, rotation.wz)
        self._last = ZERO_TWIST
        self._memo: tuple[Twist, Twist, Projection] | None = None

    def keep(self, twist: Twist) -> None:
        """Stores the reachable twist that the wheels point along."""
        if twist != ZERO_TWIST:
            self._last = twist

    def resume(self, previous: ReachableTwists) -> None:
        """Copies the stored twist from ``previous``."""
        self._last = previous._last

    def reset(self) -> None:
        """Discards the stored twist."""
        self._last = ZERO_TWIST

    def feasible(self, twist: Twist) -> Twist:
        """Returns the twist that ``project`` returns, without the limiting wheels."""
        if self._unconstrained and self.unlimited:
            return twist
        return self.project(twist).twist

    def project(self, twist: Twist) -> Projection:
        """Returns the reachable twist for ``twist``, and the wheels that limit it."""
        start = self._fixed.feasible(twist)
        for _, wheel in self._wheels:
            if not wheel.allows(start):
                break
        else:
            return Projection(start, ())
        memo = self._memo
        if memo is not None and memo[0] == start and memo[1] == self._last:
            return memo[2]
        limiting = tuple(i for group, w in self._wheels if not w.allows(start) for i in group)
        projection = Projection(self._nearest(start), limiting)
        self._memo = (start, self._last, projection)
        return projection

    def _allows(self, twist: Sequence[float]) -> bool:
        return all(wheel.allows(twist) for _, wheel in self._wheels)

    def _nearest(self, twist: Twist) -> Twist:
        wz = twist.wz
        rx, ry, rw = self._rotation
        along = Twist(twist.vx - wz * rx, twist.vy - wz * ry, 0.0)
        if along.speed < 1e-12 * abs(wz):  # rounding errors of a turn on the spot
            along = ZERO_TWIST
        candidates: list[Twist] = []
        shares = self._shares(along, Twist(wz * rx, wz * ry, wz * rw)) if wz and along.speed else []
        wider = self._first(
            Twist(along.vx + k * wz * rx, along.vy + k * wz * ry, k * wz * rw)
            for k in [*sorted((k for k in shares if 0.0 < k < 1.0), reverse=True), 0.0]
        )
        slower = self._first(
            Twist(along.vx / k + wz * rx, along.vy / k + wz * ry, wz * rw)
            for k in [*sorted(k for k in shares if k > 1.0), math.inf]
        )
        if wider is not None:
            candidates.append(wider)
        elif self._unconstrained:
            candidates += self._other_directions(twist)
        if slower is not None:
            candidates.append(slower)
        return min(candidates, key=lambda c: self._distance(c, twist), default=ZERO_TWIST)

    def _first(self, twists: Iterator[Twist]) -> Twist | None:
        return next((twist for twist in twists if self._allows(twist)), None)

    def _shares(self, along: Twist, rotation: Twist) -> list[float]:
        """Returns all numbers k at which along + k rotation brings a wheel to a limit."""
        shares: list[float] = []
        for row in self._rows:
            turning = _product(row, rotation)
            if turning:
                shares.append(-_product(row, along) / turning)
        for _, wheel in self._wheels:
            shares += wheel.tangents(along, rotation)
        return [k for k in shares if math.isfinite(k)]

    def _other_directions(self, twist: Twist) -> list[Twist]:
        """Returns the nearest reachable twist to each side of the commanded velocity."""
        vx, vy, wz = twist
        speed = twist.speed
        if speed == 0.0:
            return []
        turned: list[tuple[float, float]] = []  # deviation (rad), yaw rate per commanded speed
        for turn in (0.0, wz / speed) if wz else (0.0,):
            for tx, ty, tw in self._rows:
                # tx cos(a) + ty sin(a) = -tw turn
                size = math.hypot(tx, ty)
                offset = -tw * turn / size
                if abs(offset) <= 1.0:
                    middle, half = math.atan2(ty, tx), math.acos(offset)
                    turned += [(middle + half, turn), (middle - half, turn)]
        for i, (ax, ay, aw) in enumerate(self._rows if wz else ()):
            for bx, by, bw in self._rows[:i]:
                x, y, w = ay * bw - aw * by, aw * bx - ax * bw, ax * by - ay * bx
                size = math.hypot(x, y)
                if size < 1e-9:
                    continue
                turned += [
                    (math.atan2(s * y, s * x), s * w / size)
                    for s in (1.0, -1.0)
                    if 0.0 <= s * w * wz <= wz * wz * size / speed
                ]
        direction = math.atan2(vy, vx)
        deviations = [(math.remainder(angle - direction, math.tau), turn) for angle, turn in turned]
        deviations = [d for d in deviations if abs(d[0]) < _LARGEST_DEVIATION]
        deviations.sort(key=lambda d: (abs(d[0]), -abs(d[1])))
        results: list[Twist] = []
        for side in (1.0, -1.0):
            for deviation, turn in deviations:
                if deviation * side < 0.0:
                    continue
                size = speed * math.cos(2.0 * deviation)
                angle = direction + deviation
                candidate = Twist(size * math.cos(angle), size * math.sin(angle), size * turn)
                if self._allows(candidate):
                    results.append(candidate)
                    break
        return results

    def _distance(self, twist: Twist, commanded: Twist) -> float:
        """Returns the distance (m/s) of two twists, longer if wheels must turn around."""
        dx, dy = twist.vx - commanded.vx, twist.vy - commanded.vy
        dw = self._length * (twist.wz - commanded.wz)
        distance = math.sqrt(dx * dx + dy * dy + dw * dw)
        last = self._last
        for _, wheel in self._wheels:
            row = wheel.middle
            if row is not None and _product(row, twist) * _product(row, last) < 0.0:
                size = math.hypot(commanded.vx, commanded.vy, self._length * commanded.wz)
                return distance + _KEEP * size
        return distance


def _product(row: Row, twist: Twist) -> float:
    vx, vy, wz = twist
    return row[0] * vx + row[1] * vy + row[2] * wz


class SkidSteering:
    """Compensation of the yaw rate that a robot loses by skidding.

    A robot turns by skidding if its fixed wheels are not in line.

    With Coulomb friction and equal loads, the yaw rate is the least-squares fit of a twist to the
    surface velocities of the wheels.  Wheel i has the position a_i across the wheels and l_i along
    the wheels, both relative to the mean position.  Yaw rate wz of a skidding robot whose wheels i
    roll at the speeds v_i:

        wz = -sum a_i v_i / (sum a_i^2 + sum l_i^2)

    Without skidding, a robot with the wheel speeds v_i = -a_i wz' would turn at the yaw rate wz'.
    With the same wheel speeds, a skidding robot turns only at the yaw rate g wz', where g = sum
    a_i^2 / (sum a_i^2 + sum l_i^2).  For four wheels at (+-a, +-b), the factor is g = b^2 / (a^2 +
    b^2).  To turn a skidding robot at the yaw rate wz, the compensation computes the wheel speeds
    for the yaw rate wz / g.
    """

    def __init__(self, inverse_gain: float, middle: float, normal: tuple[float, float]) -> None:
        self._inverse_gain = inverse_gain
        self._middle = middle
        self._normal = normal

    @staticmethod
    def from_geometry(geometry: BaseGeometry, fixed: FixedWheels) -> SkidSteering | None:
        """Returns the skid compensation, or ``None`` if the robot turns without skidding."""
        if geometry.steering_groups or not fixed.skids or len(fixed.rows) != 1:
            return None
        wheels = [w for w in geometry.wheels if w.fixed]
        driven = [w for w in wheels if w.driven]
        # The normal of the fixed wheels is (t1, t2), so their rolling direction is (t2, -t1).
        t1, t2, _ = fixed.rows[0]
        across = [t1 * w.x + t2 * w.y for w in driven]
        middle = float_sum(across) / len(across)
        turning = float_sum((a - middle) ** 2 for a in across)
        along = [t2 * w.x - t1 * w.y for w in wheels]
        mean = float_sum(along) / len(wheels)
        resisting = float_sum((a - mean) ** 2 for a in along)
        if turning < 1e-6:
            return None
        return SkidSteering((turning + resisting) / turning, middle, (t1, t2))

    def compensate(self, twist: Twist) -> Twist:
        """Returns the twist whose wheel speeds make the skidding robot move with ``twist``.

        The compensation adds a rotation about the middle of the driven wheels, so the mean speed of
        the driven wheels does not change.
        """
        t1, t2 = self._normal
        added_turn = (self._inverse_gain - 1.0) * twist.wz
        along = added_turn * self._middle
        return Twist(twist.vx + t2 * along, twist.vy - t1 * along, twist.wz + added_turn)
