"""Correlation in time of the measurement errors of a joint log, from the residuals of the fit.

Errors from ground and tyres last longer than a tick.  The sum of n correlated errors has a larger
variance than the sum of n independent errors, so that the standard error of an estimate is larger.
This module describes the autocorrelation rho(t) of the errors by a mixture of known shapes:

    rho(t) = sum_j share_j shape_j(t) + lasting exp(-t / LASTING_TIME)

- Three shapes for errors without memory: white, and the correlations +0.5 and -0.5 between
  neighbouring ticks.  A tick contains the mean of two successive angles (+0.5), or the difference
  of two successive positions (-0.5).
- Exponential shapes exp(-t / tau) with the time constants ``TIME_CONSTANTS``.
- A lasting part, which changes with the motion of the robot, in seconds.

Errors of the first two kinds are random: a longer log reduces them.  Errors of the lasting part are
systematic, such as the side slip of a wheel in a turn: they return with each turn, and a longer log
does not reduce them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from thorvaldc.model.spatial import float_sum
from thorvaldc.tools.calibration.log_intervals import Array

TIME_CONSTANTS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.2)
"""Time constants (s) of the exponential shapes."""
LASTING_TIME = 4.0
"""Time constant (s) of the lasting part."""
LONGEST_LAG = 4.0
"""Longest lag (s) at which the autocorrelation of the residuals is measured."""
_LAGS = 40
_SIGNIFICANT = 3.0
"""The lasting part counts if it exceeds this multiple of its standard error."""
_NEIGHBOURS = (0.0, 0.5, -0.5)


@dataclass(frozen=True, slots=True)
class Correlation:
    """Autocorrelation of the errors of one group of measurements.

    - ``neighbours``: shares of the errors with the correlation 0, 0.5 and -0.5 between neighbouring
      ticks, and no correlation at longer lags.
    - ``exponential``: share of each exponential shape, in the order of ``TIME_CONSTANTS``.
    - ``lasting``: share of the lasting part in the variance of the errors.
    """

    neighbours: tuple[float, float, float]
    exponential: tuple[float, ...]
    lasting: float

    def time_per_sample(self, dt: float) -> float:
        """Returns the time (s) per independent random error, in a log with the tick ``dt`` (s).

        The time per independent error is the integral of the autocorrelation without its lasting
        part, from minus to plus infinity.
        """
        ticks = float_sum(
            share * (1.0 + 2.0 * neighbour)
            for share, neighbour in zip(self.neighbours, _NEIGHBOURS, strict=True)
        )
        exponentials = zip(self.exponential, TIME_CONSTANTS, strict=True)
        return dt * ticks + float_sum(
            share * dt / math.tanh(dt / (2.0 * tau)) for share, tau in exponentials
        )


WHITE = Correlation((1.0, 0.0, 0.0), (0.0,) * len(TIME_CONSTANTS), 0.0)


def estimate_correlation(
    times: Array, residuals: Array, weights: Array, redundancy: float
) -> Correlation:
    """Estimates the autocorrelation of a group of measurement errors from their residuals.

    - ``times``: time of each tick, s.
    - ``residuals``: residuals, shape (ticks, measurements), in units of their standard deviations.
    - ``weights``: weight of each tick in the fit.
    - ``redundancy``: number of redundant measurements in a tick.
    """
    ticks, measurements = residuals.shape
    if ticks < 10 or measurements == 0 or redundancy < 1e-6:
        return WHITE
    dt = float(np.median(np.diff(times)))
    scaled = residuals * np.sqrt(weights)[:, None]
    variance = float(np.mean(scaled**2))
    if variance < 1e-20:
        return WHITE
    longest = min(int(LONGEST_LAG / dt), ticks // 4)
    steps = np.unique(np.round(np.geomspace(1, max(longest, 1), _LAGS)).astype(int))
    lags, values = [0.0], [1.0]
    for step in steps:
        lag = times[step:] - times[:-step]
        whole = np.abs(lag - step * dt) < 0.5 * dt  # no gap in between
        if np.count_nonzero(whole) < ticks // 8:
            continue
        lags.append(step * dt)
        products = np.sum(scaled[step:] * scaled[:-step], axis=1)
        values.append(float(np.mean(products[whole])) / measurements / variance)
    shapes = np.stack(
        [
            *(_neighbour_shape(np.array(lags), dt, n) for n in _NEIGHBOURS),
            *(np.exp(-np.array(lags) / tau) for tau in TIME_CONSTANTS),
            np.exp(-np.array(lags) / LASTING_TIME),
        ],
        axis=1,
    )
    measured = np.array(values)
    shares = _non_negative(shapes, measured)
    correlation = _correlation(shares)
    # Standard error of the lasting part: by Bartlett's formula, the sample autocorrelation at a
    # long lag has the variance (integral of rho^2) / duration, for one redundant measurement.
    smooth = shapes[:, :-1] @ shares[:-1]
    square = float(np.trapezoid(smooth**2, lags)) * 2.0 + dt
    deviation = math.sqrt(square / (ticks * dt * redundancy))
    if shares[-1] < _SIGNIFICANT * deviation:
        correlation = _correlation(np.append(_non_negative(shapes[:, :-1], measured), 0.0))
    return correlation


def _correlation(shares: Array) -> Correlation:
    total = max(float(np.sum(shares)), 1e-12)
    values = [float(share) / total for share in shares]
    return Correlation((values[0], values[1], values[2]), tuple(values[3:-1]), values[-1])


def _neighbour_shape(lags: Array, dt: float, neighbour: float) -> Array:
    shape: Array = np.where(lags < 0.5 * dt, 1.0, np.where(lags < 1.5 * dt, neighbour, 0.0))
    return shape


def _non_negative(shapes: Array, values: Array) -> Array:
    """Returns the non-negative least-squares fit of a mixture of shapes, by coordinate descent."""
    normal, right = shapes.T @ shapes, shapes.T @ values
    shares = np.zeros(shapes.shape[1])
    for _ in range(500):
        largest = 0.0
        for j in range(len(shares)):
            change = max(shares[j] + (right[j] - normal[j] @ shares) / normal[j, j], 0.0)
            largest = max(largest, abs(change - shares[j]))
            shares[j] = change
        if largest < 1e-5:
            break
    return shares


def random_spread(times: Array, gradients: Array, correlation: Correlation) -> Array:
    """Returns the covariance of the sum of all gradients for random errors of variance 1.

    ``gradients`` has the shape (ticks, measurements, parameters).  The errors of different
    measurements are independent; the errors of one measurement have the autocorrelation
    ``correlation``, without its lasting part.
    """
    ticks = len(gradients)
    flat = gradients.reshape(ticks, -1)

    def with_shape(past: Array) -> Array:
        """Returns sum_t (g_t g_t' + g_t p_t' + p_t g_t'), with p the weighted sum of past g."""
        past = past.reshape(gradients.shape)
        own = np.einsum("trp,trq->pq", gradients, gradients, optimize=True)
        cross = np.einsum("trp,trq->pq", gradients, past, optimize=True)
        total: Array = own + cross + cross.T
        return total

    parameters = gradients.shape[2]
    spread = np.zeros((parameters, parameters))
    for share, neighbour in zip(correlation.neighbours, _NEIGHBOURS, strict=True):
        if share > 0.0:
            past = np.zeros_like(flat)
            past[1:] = neighbour * flat[:-1]
            spread += share * with_shape(past)
    for share, tau in zip(correlation.exponential, TIME_CONSTANTS, strict=True):
        if share > 1e-4:
            spread += share * with_shape(_decaying_sum(times, flat, tau) - flat)
    return spread


def _decaying_sum(times: Array, values: Array, tau: float) -> Array:
    """Returns sum over s <= t of exp(-(times_t - times_s) / tau) values_s, for each tick t.

    Recursive doubling: after k passes, the sum contains the last 2^k ticks.
    """
    total = values.copy()
    step = 1
    while step < len(times):
        factors = np.exp(-(times[step:] - times[:-step]) / tau)
        if float(np.max(factors)) < 1e-6:
            break
        total[step:] += factors[:, None] * total[:-step]
        step *= 2
    return total
