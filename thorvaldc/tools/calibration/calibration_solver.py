"""Least-squares solver of the self-calibration (see the module ``self_calibration``)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from thorvaldc.model import Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.se2 import ORIGIN, Twist
from thorvaldc.tools.calibration import calibration_log
from thorvaldc.tools.calibration.calibration_log import Array, Ticks

MAX_OFFSET, MAX_RATIO = math.radians(45.0), 0.2
"""Largest plausible errors of a steering offset (rad) and of a wheel radius (relative).

The solver rejects a fit with a larger error.
"""
MAX_OFFSET_ERROR = math.radians(0.2)
"""A steering offset counts as settled up to this standard error (rad)."""
MAX_RATIO_ERROR = 0.002
"""A wheel radius counts as settled up to this relative standard error."""

# Default standard deviations of the rolling speed (relative to the speed), of the wheel direction
# (rad), and of the speed at rest (m/s).
_ROLLING, _ANGLE, _FLOOR = 0.01, math.radians(0.5), 0.002
_SKID = 0.1  # standard deviation relative to the speed, for fixed wheels that scrub in turns
_PRIOR_OFFSET, _PRIOR_RATIO = math.radians(3.0), 0.02
# Constant side slip has the same effect as a steering offset and leaves no residual.  In
# simulations with an offset error of one degree at each wheel, only about half of the side slip
# varied and was visible in the residuals.
_HIDDEN_SLIP = 2.0
# Least systematic errors (rad, relative).  Below them, a wheel is not a rigid disc with a contact
# point: its rolling radius depends on load and torque, and its direction on the side force.
_LEAST_OFFSET, _LEAST_RATIO = math.radians(0.005), 5e-5
_ITERATIONS = 60
_AGREES = math.radians(0.05)
_HARDLY = 30.0
"""Factor of the standard deviation of a measurement that should not influence the fit."""


@dataclass(frozen=True, slots=True)
class StandardErrors:
    """Standard errors of all wheels: of the offsets (rad), and of the logarithms of the ratios."""

    offsets: Array
    ratios: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """Estimated parameters of each wheel, with their standard errors and the quality of the fit.

    - ``offsets``: steering offsets, rad.
    - ``ratios``: logarithms of the ratios of the estimated to the present wheel radii.
    - ``random``: standard errors from random measurement errors.  A longer log reduces them.
    - ``systematic``: standard errors from errors that last over the whole log, such as side slip.
    - ``covariance``: covariance of the parameters from random measurement errors.
    - ``sample_times``: time (s) per independent error of the rolling speeds and of the directions.
    - ``rolling``: standard deviation of the rolling speed residuals in a tick, relative to the
      speed.
    - ``pointing``: standard deviation of the direction residuals in a tick, rad.
    - ``slip``: part of ``pointing`` that lasts over many ticks, at the worst wheel, rad.
    - ``consistent``: ``True`` if the steering angles alone agree with the present steering offsets.
      With consistent steering angles, the axle lines of all wheels always meet in one point.
    - ``iterations``: number of Gauss-Newton iterations.
    """

    offsets: Array
    ratios: Array
    random: StandardErrors
    systematic: StandardErrors
    covariance: Array
    sample_times: tuple[float, float]
    rolling: float
    pointing: float
    slip: float
    consistent: bool
    iterations: int

    @property
    def factors(self) -> tuple[float, float]:
        """Factors of the standard deviations of the rolling speeds and of the wheel directions."""
        return self.rolling / _ROLLING, self.pointing / _ANGLE


@dataclass(slots=True)
class _Rows:
    """Linear measurement equations of all ticks for given steering offsets and radius ratios.

    The array ``matrix`` has the shape (ticks, rows, 3).  The product of ``matrix`` and the twist is
    the expected value of ``measured`` (m/s).  The first rows of ``matrix`` are the rolling rows of
    the wheels with encoder.  The next rows of ``matrix`` are the pointing rows of the steered
    wheels, which compare the direction of the wheel with its motion.  The last rows of ``matrix``
    describe the side slip of the fixed axles.
    """

    matrix: Array
    measured: Array


@dataclass(slots=True)
class _Fit:
    """Result of the Gauss-Newton iterations of the calibration.

    - ``parameters``: estimated parameters.
    - ``information``: information matrix of the parameters.
    - ``factors``: factors of the standard deviations of the rolling rows and the pointing rows.
    - ``iterations``: number of iterations.
    - ``twists``: twist of each tick with the smallest residuals.
    - ``sigmas``: standard deviations of the measurements, m/s.
    - ``weights``: weight of each tick in the fit.
    - ``slope``: derivatives of the residuals with respect to the parameters, without the part that
      a change of the twist explains.
    - ``residuals``: weighted measurement residuals of each tick, at the twists ``twists``.
    - ``redundancy``: mean redundancy of each measurement.  The redundancy is the share of its
      variance that remains in the residual.
    """

    parameters: Array
    information: Array
    factors: tuple[float, float]
    iterations: int
    twists: Array
    sigmas: Array
    weights: Array
    slope: Array
    residuals: Array
    redundancy: Array


class Solver:
    """Gauss-Newton solver for the steering offsets and the radius ratios of the wheels.

    Each steering joint has an unknown steering offset.  Each wheel with encoder has an unknown log
    ratio, the logarithm of its radius ratio.  The sum of the log ratios of all wheels is zero.  The
    solver estimates the coordinates of the log ratios in a basis of the vectors with zero sum.
    """

    def __init__(self, robot: Robot, ticks: Ticks) -> None:
        self.ticks = ticks
        geometry = BaseGeometry.from_robot(robot)
        wheels = geometry.wheels
        self.n = len(wheels)
        self.lever = geometry.length
        self.roll = np.array([i for i, w in enumerate(wheels) if w.encoder and not w.swivel], int)
        self.point = np.array([i for i, w in enumerate(wheels) if w.steered], int)
        # The solver computes twists about the centroid of the wheels.  The yaw rate is multiplied
        # by a length (m), so that all components of a twist have the unit m/s.
        self.centre = xm, ym = geometry.centre
        self.x = np.array([w.x - xm for w in wheels])
        self.y = np.array([w.y - ym for w in wheels])
        self.heading = np.array([w.heading for w in wheels])
        self.sign = np.array([w.sign if w.steered else 0.0 for w in wheels])
        self.trail = np.array([w.trail for w in wheels])
        self.lateral = np.array([w.lateral for w in wheels])
        self.radius = np.array([w.radius for w in wheels])
        fixed = FixedWheels(wheels)
        self.axles = np.array(
            [(tx, ty, (tw + tx * ym - ty * xm) / self.lever) for tx, ty, tw in fixed.rows], float
        ).reshape(-1, 3)
        self.axle_sigma = _SKID if fixed.skids else _ANGLE
        groups = geometry.steering_groups
        self.turns = np.zeros((self.n, len(groups)))  # 1 if the joint turns the wheel, else 0
        for g, group in enumerate(groups):
            self.turns[list(group), g] = 1.0
        self.basis = _zero_sum(len(self.roll))
        present = [encoder_offset(robot, group[0]) for group in groups]
        self.start = np.array([*present, *[0.0] * self.basis.shape[1]], float)
        self.prior = np.array(
            [_PRIOR_OFFSET**-2] * len(groups) + [_PRIOR_RATIO**-2] * self.basis.shape[1]
        )

    def solve(self) -> Solution | None:
        """Returns the steering offsets and radius ratios that fit the log best.

        Returns ``None`` if the estimated offsets or ratios are not plausible.
        """
        try:
            return self._solve()
        except np.linalg.LinAlgError:
            return None

    def _solve(self) -> Solution | None:
        fit = self._fit((1.0, 10.0), update_factors=True)
        if fit is None:
            return None
        m = len(self.roll)
        offsets, ratios = self._per_wheel(fit.parameters)
        present, _ = self._per_wheel(self.start)
        rolling = fit.factors[0] * _ROLLING
        if (
            np.max(np.abs(offsets - present), initial=0.0) > MAX_OFFSET
            or max(np.max(np.abs(ratios), initial=0.0), rolling) > MAX_RATIO
        ):
            return None
        random, systematic, lasting, sample_times = self._covariances(fit)
        if not (np.all(np.isfinite(random)) and np.all(np.isfinite(systematic))):
            return None
        return Solution(
            offsets,
            ratios,
            self._standard_errors(random),
            self._standard_errors(systematic, _LEAST_OFFSET, _LEAST_RATIO),
            random,
            sample_times,
            rolling,
            fit.factors[1] * _ANGLE,
            float(np.max(lasting[m:], initial=0.0)),
            self._consistent(),
            fit.iterations,
        )

    def _standard_errors(
        self, covariance: Array, least_offset: float = 0.0, least_ratio: float = 0.0
    ) -> StandardErrors:
        """Returns the standard errors of all wheels from a covariance of the parameters.

        ``least_offset`` and ``least_ratio`` are independent further errors.
        """
        s = self.turns.shape[1]
        ratios = np.zeros(self.n)
        ratios[self.roll] = np.sqrt(np.diag(self.basis @ covariance[s:, s:] @ self.basis.T))
        offsets = self.turns @ np.sqrt(np.diag(covariance)[:s])
        return StandardErrors(np.hypot(offsets, least_offset), np.hypot(ratios, least_ratio))

    def _consistent(self) -> bool:
        """Checks whether the steering angles alone agree with the present steering offsets.

        The check repeats the fit with very large standard deviations of the rolling speeds.
        """
        count = self.turns.shape[1]
        fit = self._fit((_HARDLY, 1.0), update_factors=False)
        if fit is None or not count:
            return False
        errors = np.sqrt(np.diag(self._covariances(fit)[0]))[:count]
        changes = np.abs(fit.parameters - self.start)[:count]
        determined = bool(np.all(errors < MAX_OFFSET_ERROR))
        return determined and bool(np.all(changes < np.maximum(3.0 * errors, _AGREES)))

    # -- one fit ------------------------------------------------------------------------

    def rows(self, offsets: Array, ratios: Array) -> _Rows:
        """Returns the measurement equations for given steering offsets (rad) and log ratios."""
        ticks = self.ticks
        direction = self.heading + self.sign * (ticks.angles + offsets)
        c, s = np.cos(direction), np.sin(direction)
        turning = self.sign * ticks.turning
        along = np.stack([c, s, (s * self.x - c * self.y - self.lateral) / self.lever], -1)
        across = np.stack([-s, c, (c * self.x + s * self.y + self.trail) / self.lever], -1)
        speeds = self.radius * np.exp(ratios) * ticks.speeds + self.lateral * turning
        axles = np.broadcast_to(self.axles, (len(c), *self.axles.shape))
        return _Rows(
            np.concatenate([along[:, self.roll], across[:, self.point], axles], 1),
            np.concatenate(
                [
                    speeds[:, self.roll],
                    -(self.trail * turning)[:, self.point],
                    np.zeros((len(c), len(self.axles))),
                ],
                1,
            ),
        )

    def sigmas(self, twists: Array, factors: tuple[float, float]) -> Array:
        """Returns the standard deviations (m/s) of all measurements for given twists."""
        speed = np.hypot(*self._ground(twists))
        mean = np.sqrt(np.mean(speed**2, axis=1, keepdims=True))
        rolling = factors[0] * np.hypot(_ROLLING * speed[:, self.roll], _FLOOR)
        pointing = factors[1] * np.hypot(_ANGLE * speed[:, self.point], _FLOOR)
        axles = factors[1] * np.hypot(self.axle_sigma * mean, _FLOOR)
        return np.concatenate([rolling, pointing, np.repeat(axles, len(self.axles), 1)], 1)

    def twists(self, rows: _Rows, sigmas: Array) -> tuple[Array, Array, Array, Array]:
        """Computes the twist of each tick with the smallest weighted residuals.

        Returns the twists (m/s, with the yaw rate multiplied by a length), the weighted measurement
        matrices A, the matrices (A' A)^-1, and the weighted residuals.
        """
        matrix = rows.matrix / sigmas[..., None]
        measured = rows.measured / sigmas
        normal = np.swapaxes(matrix, 1, 2) @ matrix
        # Regularisation: the estimated speed in a direction that no wheel measures is 0.
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        inverse: Array = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        twists = (inverse @ (np.swapaxes(matrix, 1, 2) @ measured[..., None]))[..., 0]
        residuals = (matrix @ twists[..., None])[..., 0] - measured
        return twists, matrix, inverse, residuals

    def _fit(self, factors: tuple[float, float], *, update_factors: bool) -> _Fit | None:
        """Fits the parameters by Gauss-Newton iterations, which also update the tick weights.

        ``factors`` contains the factors of the standard deviations of the rolling speeds and of the
        wheel directions.  With ``update_factors``, each iteration also estimates both factors.
        """
        m = len(self.roll)
        parameters = self.start
        rows = self.rows(*self._per_wheel(parameters))
        twists = self.twists(rows, np.ones(rows.measured.shape))[0]
        iterations = 0
        while iterations < _ITERATIONS:
            iterations += 1
            offsets, ratios = self._per_wheel(parameters)
            sigmas = self.sigmas(twists, factors)
            twists, matrix, inverse, residuals = self.twists(self.rows(offsets, ratios), sigmas)
            slope = self._projected_slope(twists, offsets, ratios, sigmas, matrix, inverse)
            weights = _weights(residuals)
            information = np.einsum("t,trp,trq->pq", weights, slope, slope, optimize=True)
            information += np.diag(self.prior)
            gradient: Array = np.einsum("t,trp,tr->p", weights, slope, residuals, optimize=True)
            gradient += self.prior * (parameters - self.start)
            step: Array = -np.linalg.solve(information, gradient)
            parameters = parameters + step
            if not np.all(np.isfinite(parameters)):
                return None
            previous = factors
            redundancy = 1.0 - np.einsum("tri,tij,trj->tr", matrix, inverse, matrix, optimize=True)
            if update_factors:
                factors = (
                    _factor(factors[0], weights, residuals[:, :m], redundancy[:, :m]),
                    _factor(factors[1], weights, residuals[:, m:], redundancy[:, m:]),
                )
            settled = all(abs(a / b - 1.0) < 0.01 for a, b in zip(factors, previous, strict=True))
            if np.max(np.abs(step), initial=0.0) < 1e-7 and settled:
                break
        return _Fit(
            parameters,
            information,
            factors,
            iterations,
            twists,
            sigmas,
            weights,
            slope,
            residuals,
            np.mean(redundancy, axis=0),
        )

    def _covariances(self, fit: _Fit) -> tuple[Array, Array, Array, tuple[float, float]]:
        """Returns the random and the systematic covariance of the parameters.

        Both follow from the sandwich formula M^-1 G M^-1.  M is the information matrix of the
        parameters.  G is the covariance of the gradient: of random errors with the correlation of
        the residuals, or of an unknown radius ratio and steering offset of each wheel.  The third
        array contains the standard deviations of these unknown errors, from the lasting part of the
        residuals (rolling speeds: relative, wheel directions: rad).  The last result is the time
        (s) per independent error of the rolling speeds and of the wheel directions.
        """
        m = len(self.roll)
        times = self.ticks.times
        gradients = fit.weights[:, None, None] * fit.slope
        spread = np.diag(self.prior)
        lasting: list[float] = []
        sample_times: list[float] = []
        dt = float(np.median(np.diff(times)))
        for group in (slice(None, m), slice(m, None)):
            residuals = fit.residuals[:, group]
            redundancy = float(np.sum(fit.redundancy[group]))
            correlation = calibration_log.estimate_correlation(
                times, residuals, fit.weights, redundancy
            )
            variance = 1.0
            if redundancy > 1e-6:
                squares = float(np.sum(fit.weights[:, None] * residuals**2))
                variance = squares / (float(np.sum(fit.weights)) * redundancy)
            spread = spread + variance * calibration_log.random_spread(
                times, gradients[:, group], correlation
            )
            sample_times.append(max(variance * correlation.time_per_sample(dt), 1e-3))
            lasting += [correlation.lasting] * residuals.shape[1]
        shares, per_share = self._shares(fit)
        total = float(np.sum(fit.weights))
        mean_square = np.einsum("t,tr->r", fit.weights, shares**2) / max(total, 1e-300)
        sizes = np.sqrt(np.array(lasting[: shares.shape[1]]) * mean_square)
        pulled = np.einsum(
            "t,trp,tr->pr", fit.weights, fit.slope[:, : len(sizes)], per_share, optimize=True
        )
        pulled *= _HIDDEN_SLIP * sizes
        inverse = np.linalg.inv(fit.information)
        random: Array = inverse @ spread @ inverse
        systematic: Array = inverse @ (pulled @ pulled.T) @ inverse
        return random, systematic, sizes, (sample_times[0], sample_times[1])

    def information_per_second(
        self, factors: tuple[float, float], sample_times: tuple[float, float]
    ) -> Array:
        """Returns the mean information of the ticks about the parameters, per second.

        - ``factors``: factors of the standard deviations, as ``Solution.factors``.
        - ``sample_times``: time (s) per independent error, as ``Solution.sample_times``.
        """
        present, zero = np.zeros(self.n), np.zeros(self.n)
        rows = self.rows(present, zero)
        twists = self.twists(rows, np.ones(rows.measured.shape))[0]
        sigmas = self.sigmas(twists, factors)
        twists, matrix, inverse, _ = self.twists(rows, sigmas)
        slope = self._projected_slope(twists, present, zero, sigmas, matrix, inverse)
        m = len(self.roll)
        per_second = np.full(slope.shape[1], 1.0 / sample_times[1])
        per_second[:m] = 1.0 / sample_times[0]
        total: Array = np.einsum("r,trp,trq->pq", per_second, slope, slope, optimize=True)
        return total / len(slope)

    def _projected_slope(
        self,
        twists: Array,
        offsets: Array,
        ratios: Array,
        sigmas: Array,
        matrix: Array,
        inverse: Array,
    ) -> Array:
        """Returns the slope of the weighted residuals that no change of the twists explains."""
        slope = self._slope(twists, offsets, ratios) / sigmas[..., None]
        projected: Array = slope - matrix @ (inverse @ (np.swapaxes(matrix, 1, 2) @ slope))
        return projected

    def _shares(self, fit: _Fit) -> tuple[Array, Array]:
        """Returns the residuals of all wheels in physical units, and the conversion factors.

        The residual of a rolling speed is relative to the speed.  The residual of a wheel direction
        is an angle in rad.  The weighted residual is the product of the conversion factor and the
        residual in physical units.
        """
        speed = np.maximum(np.hypot(*self._ground(fit.twists)), calibration_log.MIN_SPEED)
        speed = np.concatenate([speed[:, self.roll], speed[:, self.point]], 1)
        per_share: Array = speed / fit.sigmas[:, : speed.shape[1]]
        return fit.residuals[:, : speed.shape[1]] / per_share, per_share

    def _ground(self, twists: Array) -> tuple[Array, Array]:
        """Returns the velocity (m/s) of each wheel's steering axis, in ``base_link``."""
        vx, vy, wz = twists[:, :1], twists[:, 1:2], twists[:, 2:] / self.lever
        return vx - wz * self.y, vy + wz * self.x

    def _slope(self, twists: Array, offsets: Array, ratios: Array) -> Array:
        """Returns the derivatives of the residuals (m/s) with respect to the parameters."""
        direction = self.heading + self.sign * (self.ticks.angles + offsets)
        c, s = np.cos(direction), np.sin(direction)
        ux, uy = self._ground(twists)
        rolling = (self.sign * (c * uy - s * ux))[:, self.roll]
        pointing = (-self.sign * (c * ux + s * uy))[:, self.point]
        by_ratio = -(self.radius * np.exp(ratios) * self.ticks.speeds)[:, self.roll]
        m, p, count = len(self.roll), len(self.point), self.turns.shape[1]
        slope = np.zeros((len(twists), m + p + len(self.axles), len(self.start)))
        slope[:, :m, :count] = rolling[..., None] * self.turns[self.roll]
        slope[:, :m, count:] = by_ratio[..., None] * self.basis
        slope[:, m : m + p, :count] = pointing[..., None] * self.turns[self.point]
        return slope

    def _per_wheel(self, parameters: Array) -> tuple[Array, Array]:
        count = self.turns.shape[1]
        ratios = np.zeros(self.n)
        ratios[self.roll] = self.basis @ parameters[count:]
        return self.turns @ parameters[:count], ratios

    # -- distance ------------------------------------------------------------------------

    def ends_apart(self, offsets: Array, ratios: Array, factors: tuple[float, float]) -> float:
        """Returns the distance (m) between the ends of the path of ``base_link``.

        The path is computed from the joint log with the steering offsets ``offsets`` (rad) and the
        log radius ratios ``ratios``.
        """
        rows = self.rows(offsets, ratios)
        twists = self.twists(rows, np.ones(rows.measured.shape))[0]
        twists = self.twists(rows, self.sigmas(twists, factors))[0]
        if not np.all(np.isfinite(twists)):
            return 0.0
        xm, ym = self.centre
        pose = ORIGIN
        for (vx, vy, turn), dt in zip(twists.tolist(), self.ticks.dt.tolist(), strict=True):
            wz = turn / self.lever
            pose = pose.moved(se2.exp(Twist(vx + wz * ym, vy - wz * xm, wz), dt))
        return math.hypot(pose.x, pose.y)


def encoder_offset(robot: Robot, wheel: int) -> float:
    """Returns the steering offset (rad) of a wheel in the robot file.

    The steering offset is 0 if the wheel has no steering motor.
    """
    joint = robot.wheels[wheel].steering_joint
    motor = robot.actuator_of(joint) if joint is not None else None
    return motor.encoder_offset if motor is not None else 0.0


def _zero_sum(n: int) -> Array:
    """Returns an orthonormal basis, shape (n, n - 1), of the vectors whose elements sum to 0.

    The columns of the returned matrix are the Helmert basis.
    """
    basis = np.zeros((n, max(n - 1, 0)))
    for k in range(1, n):
        basis[:k, k - 1] = 1.0
        basis[k, k - 1] = -float(k)
        basis[:, k - 1] /= math.sqrt(k * (k + 1.0))
    return basis


def _weights(residuals: Array) -> Array:
    """Returns the weight of each tick for a robust fit, by Geman and McClure.

    The weights are scaled by the median over all ticks of the squared residuals.
    """
    squares = np.sum(residuals**2, axis=1)
    size = max(float(np.median(squares)), 1e-12)
    weights: Array = (1.0 + squares / (9.0 * size)) ** -2.0
    return weights


def _factor(factor: float, weights: Array, residuals: Array, redundancy: Array) -> float:
    """Returns the updated factor of the standard deviations of a group of measurements.

    With the updated factor, the weighted residuals have the expected variance.
    """
    expected = float(np.sum(weights[:, None] * redundancy))
    if expected < 1e-6 * len(residuals):
        return factor
    updated = factor * math.sqrt(float(np.sum(weights[:, None] * residuals**2)) / expected)
    return min(max(updated, 1e-3), 100.0)
