"""Least-squares solver of the self-calibration (see the module ``self_calibration``)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thorvaldc.model import Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.se2 import ORIGIN, Twist
from thorvaldc.tools.calibration.log_intervals import MIN_SPEED, Array, Ticks

MAX_OFFSET, MAX_RATIO = math.radians(45.0), 0.2
"""Largest plausible errors of a steering offset (rad) and of a wheel radius (relative).

The solver rejects a fit with a larger error.
"""
MAX_OFFSET_ERROR = math.radians(0.2)
"""A steering offset counts as determined up to this standard error (rad)."""
MAX_RATIO_ERROR = 0.002
"""A wheel radius counts as determined up to this relative standard error."""

# Default standard deviations of the rolling speed (relative to the speed), of the wheel direction
# (rad), and of the speed at rest (m/s).
_ROLLING, _ANGLE, _FLOOR = 0.01, math.radians(0.5), 0.002
_SKID = 0.1  # standard deviation relative to the speed, for fixed wheels that scrub in turns
_PRIOR_OFFSET, _PRIOR_RATIO = math.radians(3.0), 0.02
# Constant side slip has the same effect as a steering offset and leaves no residual.  In
# simulations with an offset error of one degree at each wheel, only about half of the side slip
# varied and was visible in the residuals.
_HIDDEN_SLIP = 2.0
_ITERATIONS = 60
_AGREES = math.radians(0.05)
_HARDLY = 30.0
"""Factor of the standard deviation of a measurement that should not influence the fit."""


@dataclass(frozen=True, slots=True)
class Solution:
    """Estimated parameters of each wheel, with their standard errors and the quality of the fit.

    - ``offsets``: steering offsets, rad.
    - ``ratios``: logarithms of the ratios of the estimated to the present wheel radii.
    - ``offset_errors``, ``ratio_errors``: standard errors of the offsets and of the logarithms of
      the radius ratios.
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
    offset_errors: Array
    ratio_errors: Array
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
        s, m = len(self.turns[0]), len(self.roll)
        offsets, ratios = self._per_wheel(fit.parameters)
        present, _ = self._per_wheel(self.start)
        rolling = fit.factors[0] * _ROLLING
        if (
            np.max(np.abs(offsets - present), initial=0.0) > MAX_OFFSET
            or max(np.max(np.abs(ratios), initial=0.0), rolling) > MAX_RATIO
        ):
            return None
        # The part of the residuals that lasts over many ticks counts as an unknown radius ratio and
        # steering offset of each wheel.
        shares, per_share = self._shares(fit)
        lasting = _lasting(shares, fit.weights, self._blocks())
        pulled = np.einsum(
            "t,trp,tr->pr", fit.weights, fit.slope[:, : len(lasting)], per_share, optimize=True
        )
        covariance = self._covariance(fit, pulled * (_HIDDEN_SLIP * lasting))
        if not np.all(np.isfinite(covariance)):
            return None
        ratio_errors = np.zeros(self.n)
        ratio_errors[self.roll] = np.sqrt(np.diag(self.basis @ covariance[s:, s:] @ self.basis.T))
        return Solution(
            offsets,
            ratios,
            self.turns @ np.sqrt(np.diag(covariance)[:s]),
            ratio_errors,
            rolling,
            fit.factors[1] * _ANGLE,
            float(np.max(lasting[m:], initial=0.0)),
            self._consistent(),
            fit.iterations,
        )

    def _consistent(self) -> bool:
        """Checks whether the steering angles alone agree with the present steering offsets.

        The check repeats the fit with very large standard deviations of the rolling speeds.
        """
        count = self.turns.shape[1]
        fit = self._fit((_HARDLY, 1.0), update_factors=False)
        if fit is None or not count:
            return False
        errors = np.sqrt(np.diag(self._covariance(fit)))[:count]
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
            slope = self._slope(twists, offsets, ratios) / sigmas[..., None]
            slope -= matrix @ (inverse @ (np.swapaxes(matrix, 1, 2) @ slope))
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
            if update_factors:
                redundancy = 1.0 - np.einsum(
                    "tri,tij,trj->tr", matrix, inverse, matrix, optimize=True
                )
                factors = (
                    _factor(factors[0], weights, residuals[:, :m], redundancy[:, :m]),
                    _factor(factors[1], weights, residuals[:, m:], redundancy[:, m:]),
                )
            settled = all(abs(a / b - 1.0) < 0.01 for a, b in zip(factors, previous, strict=True))
            if np.max(np.abs(step), initial=0.0) < 1e-7 and settled:
                break
        return _Fit(
            parameters, information, factors, iterations, twists, sigmas, weights, slope, residuals
        )

    def _covariance(self, fit: _Fit, systematic: Array | None = None) -> Array:
        """Returns the covariance of the parameters by the sandwich formula M^-1 G M^-1.

        In the sandwich formula, M is the information matrix of the parameters, and G is the sum of
        the outer products of the gradients of all 1 s blocks.  The array ``systematic`` adds the
        errors that last over many ticks to G.
        """
        gradients = np.einsum("t,trp,tr->tp", fit.weights, fit.slope, fit.residuals, optimize=True)
        block = self._blocks()
        scores = np.zeros((block[-1] + 1, len(fit.parameters)))
        np.add.at(scores, block, gradients)
        spread = scores.T @ scores + np.diag(self.prior)
        if systematic is not None:
            spread += systematic @ systematic.T
        inverse = np.linalg.inv(fit.information)
        covariance: Array = inverse @ spread @ inverse
        return covariance

    def _blocks(self) -> NDArray[np.intp]:
        """Returns the number of the 1 s block that contains each tick.

        The 1 s blocks are numbered consecutively, without the blocks that contain no tick.
        """
        _, numbers = np.unique(
            np.floor(self.ticks.times - self.ticks.times[0]), return_inverse=True
        )
        return np.asarray(numbers, dtype=np.intp)

    def _shares(self, fit: _Fit) -> tuple[Array, Array]:
        """Returns the residuals of all wheels in physical units, and the conversion factors.

        The residual of a rolling speed is relative to the speed.  The residual of a wheel direction
        is an angle in rad.  The weighted residual is the product of the conversion factor and the
        residual in physical units.
        """
        speed = np.maximum(np.hypot(*self._ground(fit.twists)), MIN_SPEED)
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


def _lasting(shares: Array, weights: Array, block: NDArray[np.intp]) -> Array:
    """Returns the standard deviation of the lasting part of the residuals of each measurement.

    The lasting part of a residual is the part that is equal in all ticks of a 1 s block.  The
    variance of the lasting part is the variance of the block means, minus the variance that
    independent errors would cause.  The result is 0 if the variance of the block means is not
    significantly larger (4 sigma) than with independent errors.
    """
    count = block[-1] + 1
    total = np.bincount(block, weights, count)
    ticks = np.bincount(block, minlength=count)
    filled = (ticks > 5) & (total > 0.1 * ticks)
    sizes = np.zeros(shares.shape[1])
    if np.count_nonzero(filled) < 3:
        return sizes
    for i in range(shares.shape[1]):
        mean = np.bincount(block, weights * shares[:, i], count)[filled] / total[filled]
        square = np.bincount(block, weights * shares[:, i] ** 2, count)[filled] / total[filled]
        expected = float(
            np.average((square - mean**2) / (ticks[filled] - 1), weights=total[filled])
        )
        measured = float(np.average(mean**2, weights=total[filled]))
        if measured > expected * (1.0 + 4.0 * math.sqrt(2.0 / np.count_nonzero(filled))):
            sizes[i] = math.sqrt(measured - expected)
    return sizes
