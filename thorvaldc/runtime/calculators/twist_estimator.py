"""Estimator of the robot's twist from its joint states, with the causes of wheels that disagree.

Steps of an estimate (the module ``twist_fit`` derives the equations):

1.  An unweighted least-squares fit predicts the velocity of each wheel's contact.
2.  One Gauss-Newton step computes the weighted fit, with weights from the predicted velocities.
   After one step, the estimate is within a few percent of the maximum-likelihood estimate.  The
   option ``EstimatorOptions.polish`` adds more Gauss-Newton steps.
3.  A chi-square test compares the measurements of each wheel with the measurements of all other
    wheels.
4.  If a wheel fails its test, or contradicts its command, ``wheel_causes`` finds the hypotheses
    that explain the readings, and the estimate is their mixture (``wheel_mixture``).

For every wheel that does not swivel, a side slip of 0 counts as a measurement.  Every wheel with an
encoder measures its rolling speed.  If the contact of a wheel lies beside or behind its steering
axis, a turning steering joint moves the contact.  The measurements include the motion of the
contact about the steering axis.  A gyro (``JointStates.yaw_rate``) adds a measurement of the yaw
rate.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from math import dist
from statistics import NormalDist
from typing import Final, NamedTuple

from thorvaldc.model.spatial import symmetric_eigenvalues
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.base_interface import CheckedJointStates, JointStates, NotFiniteError
from thorvaldc.runtime.calculators import wheel_causes, wheel_contradictions, wheel_mixture
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.twist_fit import (
    ROLL_AND_SIDE,
    SIDE_ONLY,
    TEST_ROLL,
    TEST_SIDE,
    UNTESTABLE,
    USE_ROLL,
    USE_SIDE,
    Fit,
    Measurement,
    Noise,
    NormalEquations,
    WheelConstants,
    chi_squares,
    fit_twist,
    solve3,
    unweighted_normal_equations,
)
from thorvaldc.runtime.se2 import Cov3, Row3, Twist

__all__ = ["EstimatorOptions", "Noise", "TwistEstimate", "TwistEstimator"]

_UNBOUNDED: Final = "the joint states are out of all bounds"
_SKID_TURN: Final = 0.07
"""Standard deviation of the yaw rate by wheels that skid, relative to it, common to all wheels.

In MuJoCo, 99.9 % of the yaw rates of robots with four and six skidding wheels are 0.92 to 1.15 of
that of the wheels.
"""
RANK_TOLERANCE: Final = 1e-8
"""The normal matrix has rank 3 if its scaled determinant is at least this large.

The scaled determinant is the determinant divided by the cube of the mean eigenvalue.
"""


class TwistEstimate(NamedTuple):
    """An estimated twist with its covariance and the results of the wheel tests.

    - ``twist``: estimated twist of ``base_link``.
    - ``covariance``: covariance of vx, vy and wz, in SI units.
    - ``rank``: number of components of the twist that the joint states determine, 0 to 3. For
      undetermined components, the estimator assumes a speed of 0 with the top speed as the standard
      deviation.
    - ``chi_squares``: for each wheel, the chi-square of its disagreement with the other wheels.
      Each chi-square has two degrees of freedom, or one degree of freedom for a passive wheel.  The
      chi-square of a wheel that is not tested is 0. ``chi_squares`` is empty if the calculator does
      not test wheels.
    - ``dropped``: indices of the wheels that are clearly wrong.  The estimator has left out one or
      both measurements of each of them.
    - ``suspects``: indices of the wheels that may be wrong, if nothing decides.
    - ``sliding``: indices of the wheels that may slide over the ground.  The covariance covers all
      cases.
    """

    twist: Twist
    covariance: Cov3
    rank: int
    chi_squares: tuple[float, ...] = ()
    dropped: tuple[int, ...] = ()
    suspects: tuple[int, ...] = ()
    sliding: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class EstimatorOptions:
    """Options of the twist estimator.

    - ``gate``: share of the ticks in which the estimator may reject a wheel of a healthy robot.
    - ``faulty``: largest number of wrong wheels to leave out although they follow their commands, 0
      to 2.  If ``faulty`` is 0, wheels are tested but never left out.
    - ``polish``: number of additional Gauss-Newton steps.  Each additional Gauss-Newton step brings
      the estimated twist closer to the maximum-likelihood estimate.
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
    """Weighted least-squares estimator of the twist.

    The documentation of the module ``twist_estimator`` lists the steps of an estimate.

    The estimator leaves out only the wrong measurement of a faulty wheel, because a slipping wheel
    still measures its direction.

    - ``wheels``: constants of the wheels that do not swivel.
    - ``gates``: chi-square above which a wheel is suspect, for each wheel that does not swivel.
    - ``inverse``: upper half of the inverse of the unweighted normal matrix, and the rank of this
      matrix.  ``inverse`` is ``None`` if the matrix depends on the steering angles.
    - ``least_deviation``: distance (rad/s) of all speeds from the commands below which each wheel
      follows its command.
    - ``prior``: prior information (inverse variances) about the velocity and the yaw rate.  The
      estimator uses the prior only if the joint states do not determine the whole twist.
    """

    def __init__(
        self,
        geometry: BaseGeometry,
        noise: Noise | None = None,
        options: EstimatorOptions | None = None,
    ) -> None:
        self.noise = noise or Noise()
        self.options = options or EstimatorOptions()
        self.squares = self.noise.squares
        self._n = len(geometry.wheels)
        self._names = tuple(w.name for w in geometry.wheels)
        self._centre = xm, ym = geometry.centre
        skids = FixedWheels(geometry.wheels).skids
        wheels = []
        for i, w in enumerate(geometry.wheels):
            if w.swivel:
                continue
            c, s = math.cos(w.heading), math.sin(w.heading)
            flags = ROLL_AND_SIDE if w.encoder else SIDE_ONLY
            if i in skids:  # a skidding wheel disagrees with the other wheels in every turn
                flags &= ~(TEST_ROLL | TEST_SIDE)
            x = w.x - xm + c * w.trail - s * w.lateral
            y = w.y - ym + s * w.trail + c * w.lateral
            radius = w.radius if w.encoder else 0.0
            wheels.append(
                WheelConstants(i, w.heading, w.sign, c, s, x, y, w.trail, w.lateral, radius, flags,
                               w.steered, i in skids)
            )  # fmt: skip
        self.wheels = tuple(wheels)
        top_speed = geometry.max_wheel_speed
        self.length2 = geometry.length**2
        self.prior = (1.0 / top_speed**2, self.length2 / top_speed**2)
        # The permitted rate of false alarms is divided equally among the wheels.  The gates are the
        # quantiles of the chi-square distribution with 2 and 1 degrees of freedom for the rate of
        # each wheel.
        share = self.options.gate / max(len(wheels), 1)
        gate2, gate1 = -2.0 * math.log(share), NormalDist().inv_cdf(1.0 - share / 2.0) ** 2
        self.gates = tuple(gate2 if w.flags == ROLL_AND_SIDE else gate1 for w in wheels)
        self._price = gate1
        largest_radius = max((w.radius for w in wheels if w.radius), default=1.0)
        self.least_deviation = wheel_contradictions.FOLLOWING_FLOOR / largest_radius
        self._all_measure = len(wheels) == self._n
        self._skids = bool(skids)
        self.inverse = self._constant_inverse()

    def check(self, states: JointStates) -> None:
        """Checks joint states.

        Raises ``ValueError`` if ``states`` does not have one entry for each wheel.  Raises
        ``NotFiniteError`` if a joint state is NaN or infinite.
        """
        if type(states) is CheckedJointStates:
            return
        if not len(states.speeds) == len(states.angles) == len(states.angle_rates) == self._n:
            raise ValueError(f"joint states of {len(states.speeds)} wheels for {self._n}")
        # The sum of all joint states is finite only if each joint state is finite.  A single test
        # of the sum is faster than a test of each joint state.
        total = float_sum(states.speeds) + float_sum(states.angles) + float_sum(states.angle_rates)
        positions = states.positions
        if positions is None:
            positions = states.speeds
        elif len(positions) == self._n:
            total += float_sum(positions)
        else:
            raise ValueError(f"joint states of {len(positions)} wheels for {self._n}")
        if states.yaw_rate is not None:
            total += states.yaw_rate
        if math.isfinite(total):
            return
        for values, quantity in (
            (states.speeds, "speed"),
            (positions, "position"),
            (states.angles, "steering angle"),
            (states.angle_rates, "steering rate"),
        ):
            for name, value in zip(self._names, values, strict=True):
                if not math.isfinite(value):
                    raise NotFiniteError(f"the {quantity} of wheel {name} is {value}")
        if states.yaw_rate is not None and not math.isfinite(states.yaw_rate):
            raise NotFiniteError(f"the yaw rate is {states.yaw_rate}")
        raise NotFiniteError(_UNBOUNDED)

    def estimate(
        self, states: JointStates, commanded: Sequence[float] | None = None
    ) -> TwistEstimate:
        """Estimates the twist that agrees best with the joint states, with its covariance and rank.

        ``commanded``: last commanded speed (rad/s) of each wheel, or ``None`` if the commands are
        unknown.  The commands only help to find out why wheels disagree.

        Raises ``NotFiniteError`` if a joint state is not a finite number, or so large that the
        result is not finite.
        """
        self.check(states)
        try:
            return self._estimate(states, commanded)
        except (ZeroDivisionError, OverflowError):
            raise NotFiniteError(_UNBOUNDED) from None

    def _estimate(self, states: JointStates, commanded: Sequence[float] | None) -> TwistEstimate:
        measurements, right_side = self._measurements(states)
        yaw_rate, noise = states.yaw_rate, self.squares
        (vx, vy, wz), rank = self._unweighted_fit(measurements, right_side, yaw_rate)
        prior = (0.0, 0.0) if rank == 3 else self.prior
        fit = fit_twist(measurements, vx, vy, wz, noise, prior, yaw_rate)
        for _ in range(self.options.polish):
            fit = fit_twist(measurements, fit.vx, fit.vy, fit.wz, noise, prior, yaw_rate)
        tests = chi_squares(fit)
        if self.options.faulty:
            slip = 0.0 if yaw_rate is None else self._gyro_slip(fit, yaw_rate)
            disagree = slip > 0.0 or any(map(operator.gt, tests, self.gates))
            if disagree or self.may_deviate(states.speeds, commanded):
                return self._mixture(
                    measurements, fit, tests, prior, states, rank, commanded, disagree, slip
                )
        return self._result(fit, tests, rank, yaw_rate)

    def _gyro_slip(self, fit: Fit, yaw_rate: float) -> float:
        """Returns the speed (m/s) at the wheels by which a gyro contradicts them, or 0.

        No test of a wheel may show it.  The residual r of the gyro in a fit that gives it the
        influence h on its own estimate is r / (1 - h) without it, with the variance
        gyro^2 / (1 - h).
        """
        ratio2, _, _, _, _, gyro2 = self.squares
        others = 1.0 - fit.p33 / gyro2
        if others <= UNTESTABLE:
            return 0.0
        residual, variance = (yaw_rate - fit.wz) / others, gyro2 / others
        if self._skids:  # the skid has its own error instead of those in the fit
            turn = _SKID_TURN * (yaw_rate - residual)
            variance = gyro2 + turn * turn + ratio2 * (fit.vx**2 + fit.vy**2) / self.length2
        contradicts = residual * residual > self._price * variance
        return abs(residual) * math.sqrt(self.length2) if contradicts else 0.0

    def may_deviate(self, speeds: Sequence[float], commanded: Sequence[float] | None) -> bool:
        """Returns whether a wheel may deviate from its command (rad/s).

        A single distance of all speeds is faster than a test of each wheel.
        """
        return commanded is not None and dist(speeds, commanded) > self.least_deviation

    def least_squares(self, states: JointStates) -> Twist:
        """Returns the twist of an unweighted least-squares fit to the joint states.

        Raises ``ValueError`` or ``NotFiniteError`` for unusable joint states, as ``check`` does.
        """
        self.check(states)
        (vx, vy, wz), _ = self._unweighted_fit(*self._measurements(states), states.yaw_rate)
        xm, ym = self._centre
        return Twist(vx + ym * wz, vy - xm * wz, wz)

    def lasting_errors(
        self, states: JointStates, estimate: TwistEstimate, twist: Twist
    ) -> list[Row3]:
        """Returns the errors of ``twist`` that lasting errors of the wheels cause.

        The returned list has one entry for each wheel radius, for the common scale of all radii,
        and for the direction of each wheel at its steering zero.  The entry is the error of the
        twist (vx, vy, wz) if this value is wrong by one standard deviation
        (``Noise.lasting_errors``).

        An estimate is xi = P sum H' W m (see the module ``twist_fit``).  A relative radius error r
        changes the rolling measurement by r v, where v is the rolling speed of the wheel.  An error
        e of the steering zero rotates the measured direction and changes the side slip by e v.
        Errors of the twist:

            P L' w_L r v   and   P T' w_T e v

        The error of a common scale is the sum of the errors of all radii.

        - ``states``: joint states; only the steering angles and rates have an influence.
        - ``estimate``: an estimate with the same joint states, for the rank and the faulty wheels.
        """
        radius_error, scale_error, offset = self.noise.lasting_errors
        dropped = estimate.dropped
        measurements = self._measurements(states)[0]
        if dropped:
            measurements = [
                (m[0] & ~USE_ROLL, *m[1:]) if w.number in dropped else m
                for w, m in zip(self.wheels, measurements, strict=True)
            ]
        xm, ym = self._centre
        vx, vy, wz = twist.vx - ym * twist.wz, twist.vy + xm * twist.wz, twist.wz
        # Without the faulty encoders, the wheels may not determine the whole twist.
        prior = (0.0, 0.0) if estimate.rank == 3 and not dropped else self.prior
        fit = fit_twist(measurements, vx, vy, wz, self.squares, prior, states.yaw_rate)
        _, _, _, p11, p12, p13, p22, p23, p33, weighted = fit
        gradients: list[Row3] = []  # H' W m of each error
        s1 = s2 = s3 = 0.0
        for wheel, (flags, c, s, x, y, _, _, v_l, v_t) in zip(self.wheels, weighted, strict=True):
            # The row of a rolling speed is L = (c, s, s x - c y): the contact at (x, y) moves with
            # (vx - y wz, vy + x wz), of which the wheel measures the part along (c, s).
            turn = s * x - c * y
            roll = c * vx + s * vy + turn * wz
            if wheel.flags & USE_ROLL and (radius_error or scale_error):
                k = roll / v_l if flags & USE_ROLL else 0.0
                s1, s2, s3 = s1 + k * c, s2 + k * s, s3 + k * turn
                if radius_error:
                    k *= radius_error
                    gradients.append((k * c, k * s, k * turn))
            # The row of a side slip is T = (-s, c, c x + s y). A wheel that points e too far to
            # the left takes the part e v of its rolling speed for a side slip.
            if wheel.flags & USE_SIDE and offset:
                k = offset * roll / v_t
                gradients.append((-k * s, k * c, k * (c * x + s * y)))
        if scale_error:
            gradients.append((scale_error * s1, scale_error * s2, scale_error * s3))
        # The error P g of the twist about the centroid is converted to base_link, as in _result.
        r11, r12, r13 = p11 + ym * p13, p12 + ym * p23, p13 + ym * p33
        r21, r22, r23 = p12 - xm * p13, p22 - xm * p23, p23 - xm * p33
        return [
            (
                r11 * g1 + r12 * g2 + r13 * g3,
                r21 * g1 + r22 * g2 + r23 * g3,
                p13 * g1 + p23 * g2 + p33 * g3,
            )
            for g1, g2, g3 in gradients
        ]

    def slips(self, states: JointStates, twist: Twist) -> tuple[tuple[float, float], ...]:
        """Returns the slip velocity of each wheel's contact over the ground, for a given twist.

        The result contains, for each wheel, the slip velocity (m/s) along the wheel's direction and
        to the left of the wheel.  A wheel that spins in mud slips backwards.  The slip velocity
        along the wheel is 0 for a wheel without encoder.  Both components of the slip velocity are
        0 for a caster wheel.
        """
        slips = [(0.0, 0.0)] * self._n
        vx, vy, wz = twist
        xm, ym = self._centre
        vx, vy = vx - ym * wz, vy + xm * wz
        for wheel, (flags, c, s, x, y, z_l, z_t, _, _) in zip(
            self.wheels, self._measurements(states)[0], strict=True
        ):
            # The velocity of the contact with the body, less that of the tyre's surface.
            ux, uy = vx - wz * y, vy + wz * x
            along = c * ux + s * uy - z_l if flags & USE_ROLL else 0.0
            slips[wheel.number] = (along, c * uy - s * ux - z_t)
        return tuple(slips)

    # -- measurements and unweighted fit ----------------------------------------------

    def _measurements(
        self, states: JointStates
    ) -> tuple[list[Measurement], tuple[float, float, float]]:
        """Returns the measurements of all wheels, and the right-hand side b of the fit.

        The right-hand side b = sum L' z_L is valid only if all wheels have no trail and no lateral
        offset.
        """
        speeds, angles = states.speeds, states.angles
        measurements: list[Measurement] = []
        b1 = b2 = b3 = 0.0
        for wheel in self.wheels:
            i, heading, sign, c, s, x, y, trail, lateral, radius, flags, steered, skids = wheel
            z_l, z_t = radius * speeds[i], 0.0
            if steered:
                direction = heading + sign * angles[i]
                cos, sin = math.cos(direction), math.sin(direction)
                if trail or lateral:
                    # The position of the contact point depends on the steering angle, and its
                    # velocity about the steering axis depends on the steering rate.
                    x += (cos - c) * trail - (sin - s) * lateral
                    y += (sin - s) * trail + (cos - c) * lateral
                    turning = sign * states.angle_rates[i]
                    z_l += lateral * turning
                    z_t = -trail * turning
                c, s = cos, sin
            measurements.append((flags, c, s, x, y, z_l, z_t, steered, skids))
            # b = sum L' z_L, for wheels whose side slip z_T is 0.
            zx, zy = c * z_l, s * z_l
            b1 += zx
            b2 += zy
            b3 += zy * x - zx * y
        return measurements, (b1, b2, b3)

    def _unweighted_fit(
        self,
        measurements: list[Measurement],
        right_side: tuple[float, float, float],
        yaw_rate: float | None,
    ) -> tuple[tuple[float, float, float], int]:
        """Returns the unweighted least-squares twist about the wheels' centroid, and the rank."""
        if self.inverse is None or yaw_rate is not None:
            return self._solve(unweighted_normal_equations(measurements), yaw_rate)
        b1, b2, b3 = right_side
        (q11, q12, q13, q22, q23, q33), rank = self.inverse
        twist = (
            q11 * b1 + q12 * b2 + q13 * b3,
            q12 * b1 + q22 * b2 + q23 * b3,
            q13 * b1 + q23 * b2 + q33 * b3,
        )
        return twist, rank

    def _solve(
        self, equations: NormalEquations, yaw_rate: float | None
    ) -> tuple[tuple[float, float, float], int]:
        """Solves the unweighted normal equations for the twist, and determines their rank.

        For the rank, the yaw rate is multiplied by ``length``, so that all eigenvalues of the
        normal matrix have the same unit.
        """
        a11, a12, a13, a22, a23, a33, b1, b2, b3 = equations
        # The unweighted gyro counts as much as one wheel at the distance `length`.
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
            # A small number is added to the diagonal of the normal matrix, so that the normal
            # equations have a solution.  `prior` contains inverse variances and is not suitable for
            # unweighted rows.
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
        """Returns the inverse of the unweighted normal matrix, and the rank of this matrix.

        Returns ``None`` if the normal matrix depends on the steering angles.  The normal matrix is
        independent of the steering angle of a wheel if the wheel has an encoder and no offset from
        its steering axis.  A wheel with an encoder and no offset measures both components of the
        contact's velocity, and L'L + T'T = H'H for any direction of the wheel.
        """
        if any(w.steered and (not w.flags & USE_ROLL or w.trail or w.lateral) for w in self.wheels):
            return None
        equations = unweighted_normal_equations(
            [(w.flags, w.cos, w.sin, w.x, w.y, 0.0, 0.0, False, False) for w in self.wheels]
        )
        columns = [
            self._solve(
                equations._replace(b1=float(i == 0), b2=float(i == 1), b3=float(i == 2)), None
            )
            for i in range(3)
        ]
        (q11, q12, q13), rank = columns[0]
        (_, q22, q23), _ = columns[1]
        return (q11, q12, q13, q22, q23, columns[2][0][2]), rank

    # -- mixture and result --------------------------------------------------------------

    def _mixture(
        self,
        measurements: list[Measurement],
        fit: Fit,
        tests: list[float],
        prior: tuple[float, float],
        states: JointStates,
        rank: int,
        commanded: Sequence[float] | None,
        disagree: bool,
        gyro_slip: float,
    ) -> TwistEstimate:
        """Returns the mixture of the hypotheses that explain the readings.

        If no hypothesis explains the misfit, the estimate uses all wheels and has a larger
        covariance.
        """
        yaw_rate, turning = states.yaw_rate, []
        if commanded is not None:
            for w in self.wheels:
                i = w.number
                turning.append((w.radius * states.speeds[i], w.radius * commanded[i]))
        against = wheel_contradictions.contradiction(fit, measurements, turning)
        if not (disagree or against.doubtful):
            return self._result(fit, tests, rank, yaw_rate)
        fits = wheel_causes.Fits(
            self._solve, self.squares, prior, self.prior, yaw_rate, 1 + self.options.polish
        )
        search = wheel_causes.CauseSearch(
            self.gates, self._price, self.options.faulty, self.length2, against, fits, gyro_slip
        )
        hypotheses = search.likely_hypotheses(measurements, fit, disagree)
        if not hypotheses:
            covered = search.unexplained(measurements, fit)
            failed = [k for k, d in enumerate(tests) if d > self.gates[k]]
            return self._result(covered, tests, rank, yaw_rate, (), failed)
        mean, left_out, suspects, sliding = wheel_mixture.mixture(
            hypotheses, as_measured=not disagree
        )
        if hypotheses[0].wrong:
            tests = chi_squares(hypotheses[0].fit)
        return self._result(mean, tests, rank, yaw_rate, left_out, suspects, sliding)

    def _result(
        self,
        fit: Fit,
        tests: Sequence[float],
        rank: int,
        yaw_rate: float | None,
        dropped: Sequence[int] = (),
        suspects: Sequence[int] = (),
        sliding: Sequence[int] = (),
    ) -> TwistEstimate:
        """Returns the estimate at ``base_link``.

        - ``dropped``, ``suspects``, ``sliding``: indices of measurements.

        A fit about the centroid (xm, ym) with the twist xi and the covariance P is converted to
        ``base_link`` by xi' = A xi and P' = A P A', with A = [1 0 ym; 0 1 -xm; 0 0 1].
        """
        vx, vy, wz, p11, p12, p13, p22, p23, p33, _ = fit
        if self._skids:
            by_wheels = 1.0 if yaw_rate is None else max(1.0 - p33 / self.squares[5], 0.0)
            p33 += (_SKID_TURN * by_wheels * wz) ** 2
            slip = 4.0 * self.squares[4] * self.length2 * wz * wz
            p11, p22 = p11 + slip, p22 + slip
        xm, ym = self._centre
        if xm or ym:
            vx, vy = vx + ym * wz, vy - xm * wz
            p11, p12, p22 = (
                p11 + 2.0 * ym * p13 + ym * ym * p33,
                p12 + ym * p23 - xm * p13 - xm * ym * p33,
                p22 - 2.0 * xm * p23 + xm * xm * p33,
            )
            p13, p23 = p13 + ym * p33, p23 - xm * p33
        if not math.isfinite(vx + vy + wz + p11 + p22 + p33 + float_sum(tests)):
            raise NotFiniteError(_UNBOUNDED)
        if not self._all_measure:
            per_wheel = [0.0] * self._n
            for wheel, d in zip(self.wheels, tests, strict=True):
                per_wheel[wheel.number] = d
            tests = per_wheel
        covariance = ((p11, p12, p13), (p12, p22, p23), (p13, p23, p33))
        twist = Twist(vx, vy, wz)
        if not (dropped or suspects or sliding):
            return TwistEstimate(twist, covariance, rank, tuple(tests))
        numbers = [wheel.number for wheel in self.wheels]
        return TwistEstimate(
            twist,
            covariance,
            rank,
            tuple(tests),
            tuple(sorted(numbers[k] for k in dropped)),
            tuple(sorted(numbers[k] for k in suspects)),
            tuple(sorted(numbers[k] for k in sliding)),
        )
