"""The robot's twist from its joints, and which wheels not to believe."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

from thorvaldc.model.spatial import symmetric_eigenvalues
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.linear_algebra import solve3
from thorvaldc.runtime.calculators.twist_fit import (
    BOTH,
    SIDE,
    TEST_ROLL,
    TEST_SIDE,
    USE_ROLL,
    USE_SIDE,
    Fit,
    Noise,
    Reading,
    Row,
    Sums,
    chi_squares,
    equal_weights,
    fit,
    misfit,
)
from thorvaldc.runtime.calculators.unrolled import Estimate, UnrolledWheel, unrolled
from thorvaldc.runtime.calculators.wheel_rejection import Rejection, mixture
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.runtime.se2 import Cov3, Twist

__all__ = ["Estimation", "Noise", "TwistEstimate", "TwistEstimator"]

_NAMED = 0.6
"""Probability from which a wheel is said to be wrong: more than one half by more than rounding."""
_UNBOUNDED = "the joint states are out of all bounds"
RANK_TOLERANCE = 1e-8
"""Smallest eigenvalue of the scaled information over the mean one that counts."""


class TwistEstimate(NamedTuple):
    """A twist, its covariance (of vx, vy, wz, in SI) and what it rests on.

    ``rank`` is how many directions of the twist the joints determine, 0 to 3.
    Below 3 the rest comes from the prior that the robot stands still within
    its top speed, and the covariance says so.  ``chi_squares`` has one entry per
    wheel where the calculator tests them: how badly it agrees with the
    others, chi-square of two degrees of freedom (one for a passive wheel; 0 for
    what nothing tests).  ``dropped``: indices of the wheels that are left out, wholly
    or in part, since they slip, stall or are not where their encoders say.
    """

    twist: Twist
    covariance: Cov3
    rank: int
    chi_squares: tuple[float, ...] = ()
    dropped: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Estimation:
    """How a twist is estimated.

    ``gate``: share of ticks at which a healthy robot may lose a wheel.
    ``faulty``: how many wheels may be wrong at once, 0 (they are only tested) to 2.
    ``polish``: further Gauss-Newton steps, towards maximum likelihood.
    """

    gate: float = 0.008
    faulty: int = 2
    polish: int = 0

    def __post_init__(self) -> None:
        if not 0.0 < self.gate < 1.0:
            raise ValueError(f"gate is {self.gate:g}; it must be between 0 and 1")
        if self.faulty not in (0, 1, 2):
            raise ValueError(f"faulty is {self.faulty}; it must be 0, 1 or 2")
        if not 0 <= self.polish <= 10:
            raise ValueError(f"polish is {self.polish}; it must be 0 to 10")


class TwistEstimator:
    """Weighted least squares of what wheels say, without those that disagree.

    A first solution with equal weights predicts each wheel's velocity, and one
    Gauss-Newton step from there (``fit``) is all but maximum likelihood.  Then
    each wheel is tested against the others; where one fails, the explanation with the
    fewest wrong wheels is sought, and of those only what is wrong is left out:
    a wheel that slips still says its direction.  Where there is no explanation
    all are kept, and the covariance grows with the misfit.

    Side slip is measured as 0 on every wheel that cannot swivel, rolling on those
    with an encoder.  Steering with the contact beside or behind its axis moves
    the contact, which is counted.  A gyro (``JointStates.yaw_rate``) is one row more.

    ``rows``: the wheels that hold their direction; ``gates``: the D of each beyond
    which it is suspected; ``inverse``: of the normal matrix with equal weights (upper
    half), and its rank, where the wheels' angles do not change it; ``prior``: the
    information on velocity and yaw rate that stands in below rank 3.
    """

    def __init__(
        self,
        geometry: BaseGeometry,
        noise: Noise | None = None,
        options: Estimation | None = None,
    ) -> None:
        self.noise = noise or Noise()
        self.options = options or Estimation()
        self.squares = self.noise.squares
        self._n = len(geometry.wheels)
        self._wheels = geometry.wheels
        self._centre = xm, ym = geometry.centre
        skids = FixedWheels(geometry.wheels).skids
        rows = []
        for i, w in enumerate(geometry.wheels):
            if w.swivel:
                continue
            c, s = math.cos(w.heading), math.sin(w.heading)
            kind = BOTH if w.encoder else SIDE
            if i in skids:  # what scrubs by its place disagrees always
                kind &= ~(TEST_ROLL | TEST_SIDE)
            x = w.x - xm + c * w.trail - s * w.lateral
            y = w.y - ym + s * w.trail + c * w.lateral
            radius = w.radius if w.encoder else 0.0
            rows.append(
                Row(i, w.heading, w.sign, c, s, x, y, w.trail, w.lateral, radius, kind,
                     w.steered, i in skids)
            )  # fmt: skip
        self.rows = tuple(rows)
        top = geometry.fastest
        self.length2 = geometry.length**2
        # Information on (vx, vy, wz) where the wheels have none: at rest within the top speed.
        self.prior = (1.0 / top**2, self.length2 / top**2)
        share = self.options.gate / max(len(rows), 1)
        both, one = -2.0 * math.log(share), NormalDist().inv_cdf(1.0 - share / 2.0) ** 2
        self.gates = tuple(both if row.kind == BOTH else one for row in rows)
        self._price = one
        self._whole = len(rows) == self._n
        self.inverse = self._constant_inverse()

    def check(self, states: JointStates) -> None:
        """Raise ``NotFiniteError`` or ``ValueError`` where the joints cannot be used."""
        if not len(states.speeds) == len(states.angles) == len(states.angle_rates) == self._n:
            raise ValueError(f"joint states of {len(states.speeds)} wheels for {self._n}")
        total = sum(states.speeds) + sum(states.angles) + sum(states.angle_rates)
        positions = states.positions
        if positions is None:
            positions = states.speeds
        elif len(positions) == self._n:
            total += sum(positions)
        else:
            raise ValueError(f"joint states of {len(positions)} wheels for {self._n}")
        if states.yaw_rate is not None:
            total += states.yaw_rate
        if math.isfinite(total):
            return
        for values, what in (
            (states.speeds, "speed"),
            (positions, "position"),
            (states.angles, "steering angle"),
            (states.angle_rates, "steering rate"),
        ):
            for wheel, value in zip(self._wheels, values, strict=True):
                if not math.isfinite(value):
                    raise NotFiniteError(f"the {what} of wheel {wheel.name} is {value}")
        if states.yaw_rate is not None and not math.isfinite(states.yaw_rate):
            raise NotFiniteError(f"the yaw rate is {states.yaw_rate}")
        raise NotFiniteError(_UNBOUNDED)

    def estimate(self, states: JointStates) -> TwistEstimate:
        """The twist that agrees best with the joints, with its covariance and rank.

        Raises ``NotFiniteError`` where a joint state is not a finite number, or so large
        that there is no finite result.
        """
        self.check(states)
        try:
            return self._estimated(states)
        except (ZeroDivisionError, OverflowError):
            raise NotFiniteError(_UNBOUNDED) from None

    def _estimated(self, states: JointStates) -> TwistEstimate:
        if self._unrolled is not None and states.yaw_rate is None:
            found: TwistEstimate | None = self._unrolled(states.speeds, states.angles)
            if found is not None:
                return found
        return self._estimate_closely(states)

    def _estimate_closely(self, states: JointStates) -> TwistEstimate:
        """With loops over the wheels, for any robot and whatever its wheels say."""
        readings, (vx, vy, wz), rank = self._first(states)
        noise, rate = self.squares, states.yaw_rate
        prior = (0.0, 0.0) if rank == 3 else self.prior
        found = fit(readings, vx, vy, wz, noise, prior, rate)
        for _ in range(self.options.polish):
            found = fit(readings, found.vx, found.vy, found.wz, noise, prior, rate)
        tests = chi_squares(found)
        for d, gate in zip(tests, self.gates, strict=True):
            if d > gate and self.options.faulty:
                return self._without_the_wrong(readings, found, tests, prior, rate, rank)
        return self._estimate(found, tests, rank)

    def least_squares(self, states: JointStates) -> Twist:
        """The first solution: least squares of all rows with equal weights."""
        self.check(states)
        return self._at_base(*self._first(states)[1])

    def slips(self, states: JointStates, twist: Twist) -> tuple[tuple[float, float], ...]:
        """Per wheel, by how much its contact moves over the ground in that twist, along and across.

        In m/s, along its direction and to its left; along is that of the tread, so that
        a wheel that spins in mud slips backwards.  0 where it has no encoder, and
        for what swivels.
        """
        slips = [(0.0, 0.0)] * self._n
        vx, vy, wz = twist
        xm, ym = self._centre
        vx, vy = vx - ym * wz, vy + xm * wz
        for row, (kind, c, s, x, y, z_l, z_t, _, _) in zip(
            self.rows, self._readings(states), strict=True
        ):
            ux, uy = vx - wz * y, vy + wz * x
            along = c * ux + s * uy - z_l if kind & USE_ROLL else 0.0
            slips[row.wheel] = (along, c * uy - s * ux - z_t)
        return tuple(slips)

    # -- the first solution ---------------------------------------------------------

    def _first(self, states: JointStates) -> tuple[list[Reading], tuple[float, float, float], int]:
        """What the wheels say; the twist by it about the centre, all weighing alike; its rank."""
        if self.inverse is None or states.yaw_rate is not None:
            readings = self._readings(states)
            return readings, *self._solve(equal_weights(readings), states.yaw_rate)
        # Most robots: however the wheels turn, the normal equations stay.
        speeds, angles = states.speeds, states.angles
        cos, sin = math.cos, math.sin
        b1 = b2 = b3 = 0.0
        readings = []
        for i, heading, sign, c, s, x, y, _, _, radius, kind, turns, skids in self.rows:
            if turns:
                direction = heading + sign * angles[i]
                c, s = cos(direction), sin(direction)
            z_l = radius * speeds[i]
            readings.append((kind, c, s, x, y, z_l, 0.0, turns, skids))
            zx, zy = c * z_l, s * z_l
            b1 += zx
            b2 += zy
            b3 += zy * x - zx * y
        (q11, q12, q13, q22, q23, q33), rank = self.inverse
        twist = (
            q11 * b1 + q12 * b2 + q13 * b3,
            q12 * b1 + q22 * b2 + q23 * b3,
            q13 * b1 + q23 * b2 + q33 * b3,
        )
        return readings, twist, rank

    def _readings(self, states: JointStates) -> list[Reading]:
        readings: list[Reading] = []
        for row in self.rows:
            i, heading, sign, c, s, x, y, trail, lateral, radius, kind, turns, skids = row
            z_l, z_t = radius * states.speeds[i], 0.0
            if turns:
                direction = heading + sign * states.angles[i]
                cos, sin = math.cos(direction), math.sin(direction)
                if trail or lateral:
                    x += (cos - c) * trail - (sin - s) * lateral
                    y += (sin - s) * trail + (cos - c) * lateral
                    turning = sign * states.angle_rates[i]
                    z_l += lateral * turning
                    z_t = -trail * turning
                c, s = cos, sin
            readings.append((kind, c, s, x, y, z_l, z_t, turns, skids))
        return readings

    def _solve(self, sums: Sums, yaw_rate: float | None) -> tuple[tuple[float, float, float], int]:
        a11, a12, a13, a22, a23, a33, b1, b2, b3 = sums
        k = self.length2
        if yaw_rate is not None:
            a33 += k
            b3 += k * yaw_rate
        det = (
            a11 * (a22 * a33 - a23 * a23)
            - a12 * (a12 * a33 - a13 * a23)
            + a13 * (a12 * a23 - a13 * a22)
        )
        mean = (a11 + a22 + a33 / k) / 3.0
        rank = 3
        if det <= RANK_TOLERANCE * k * mean * mean * mean:
            rank = self._count_rank(a11, a12, a13, a22, a23, a33)
            # This pass is in units of one, the prior in those of a top speed.
            weak = 1e-6 * max(mean, 1.0)
            a11, a22, a33 = a11 + weak, a22 + weak, a33 + weak * k
        return solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3), rank

    def _count_rank(
        self, a11: float, a12: float, a13: float, a22: float, a23: float, a33: float
    ) -> int:
        k = math.sqrt(self.length2)
        values = symmetric_eigenvalues(
            ((a11, a12, a13 / k), (a12, a22, a23 / k), (a13 / k, a23 / k, a33 / k / k))
        )
        largest = max(values)
        return sum(1 for v in values if v > 1e-7 * largest) if largest > 1e-12 else 0

    def _constant_inverse(
        self,
    ) -> tuple[tuple[float, float, float, float, float, float], int] | None:
        """Inverse of the equal-weights normal matrix and its rank, where angles do not change it.

        A wheel with an encoder measures its contact's velocity whole, in whatever direction.
        """
        if any(r.turns and (not r.kind & USE_ROLL or r.trail or r.lateral) for r in self.rows):
            return None
        still = equal_weights(
            [(r.kind, r.cos, r.sin, r.x, r.y, 0.0, 0.0, False, False) for r in self.rows]
        )
        columns = [
            self._solve(still._replace(b1=float(i == 0), b2=float(i == 1), b3=float(i == 2)), None)
            for i in range(3)
        ]
        (q11, q12, q13), rank = columns[0]
        (_, q22, q23), _ = columns[1]
        return (q11, q12, q13, q22, q23, columns[2][0][2]), rank

    @functools.cached_property
    def _unrolled(self) -> Estimate | None:
        """The robot's own code for ticks with nothing unusual; ``None`` where it has no use."""
        plain = all(row.kind == BOTH and not row.skids for row in self.rows)
        if not plain or self.options.polish or self.inverse is None or self.inverse[1] < 3:
            return None
        gates = self.gates if self.options.faulty else (math.inf,) * len(self.rows)
        wheels = tuple(
            UnrolledWheel(
                r.wheel, r.heading, r.sign, r.cos, r.sin, r.x, r.y, r.radius, r.turns, gate
            )
            for r, gate in zip(self.rows, gates, strict=True)
        )
        return unrolled(wheels, self._n, self.inverse[0], self._centre, self.squares, TwistEstimate)

    def _without_the_wrong(
        self,
        readings: list[Reading],
        found: Fit,
        tests: list[float],
        prior: tuple[float, float],
        rate: float | None,
        rank: int,
    ) -> TwistEstimate:
        """The estimate without the wheels that are wrong; of all where nothing explains it."""
        steps = 1 + self.options.polish

        def again(some: list[Reading], before: Fit, steps: int = steps) -> Fit:
            for _ in range(steps):
                before = fit(some, before.vx, before.vy, before.wz, self.squares, prior, rate)
            return before

        def fresh(some: list[Reading]) -> Fit:
            first, _ = self._solve(equal_weights(some), rate)
            return again(some, fit(some, *first, self.squares, prior, rate))

        rejection = Rejection(self.gates, self._price, self.options.faulty, fresh, again)
        explanations = rejection.explanations(readings, found)
        if not explanations:
            freedom = sum((r[0] & USE_ROLL > 0) + (r[0] & USE_SIDE > 0) for r in readings)
            freedom += (rate is not None) - rank
            growth = max(1.0, misfit(found) / max(freedom, 1))
            return self._estimate(found, tests, rank, growth)
        best = explanations[0]
        mean, probability = mixture(explanations)
        dropped: tuple[int, ...] = ()
        if probability > _NAMED:
            dropped = tuple(sorted(self.rows[k].wheel for k in best.places))
        return self._estimate(mean, chi_squares(best.found), rank, 1.0, dropped)

    def _estimate(
        self,
        found: Fit,
        tests: Sequence[float],
        rank: int,
        growth: float = 1.0,
        dropped: tuple[int, ...] = (),
    ) -> TwistEstimate:
        vx, vy, wz, p11, p12, p13, p22, p23, p33, _ = found
        xm, ym = self._centre
        if xm or ym:  # from the centre back to base_link
            vx, vy = vx + ym * wz, vy - xm * wz
            p11, p12, p22 = (
                p11 + 2.0 * ym * p13 + ym * ym * p33,
                p12 + ym * p23 - xm * p13 - xm * ym * p33,
                p22 - 2.0 * xm * p23 + xm * xm * p33,
            )
            p13, p23 = p13 + ym * p33, p23 - xm * p33
        if not math.isfinite(vx + vy + wz + p11 + p22 + p33 + sum(tests)):
            raise NotFiniteError(_UNBOUNDED)
        if growth != 1.0:
            p11, p12, p13 = growth * p11, growth * p12, growth * p13
            p22, p23, p33 = growth * p22, growth * p23, growth * p33
        if not self._whole:
            spread = [0.0] * self._n
            for row, d in zip(self.rows, tests, strict=True):
                spread[row.wheel] = d
            tests = spread
        covariance = ((p11, p12, p13), (p12, p22, p23), (p13, p23, p33))
        return TwistEstimate(Twist(vx, vy, wz), covariance, rank, tuple(tests), dropped)

    def _at_base(self, vx: float, vy: float, wz: float) -> Twist:
        xm, ym = self._centre
        return Twist(vx + ym * wz, vy - xm * wz, wz)
