"""Autocorrelation of errors: its estimate from residuals, and what it does to a sum of errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from thorvaldc.tools.calibration.calibration_log import (
    TIME_CONSTANTS,
    WHITE,
    Correlation,
    estimate_correlation,
    random_spread,
)

DT = 0.02
NONE = (0.0,) * len(TIME_CONSTANTS)


def exponential(tau: float, lasting: float = 0.0) -> Correlation:
    shares = tuple((1.0 - lasting) * (t == tau) for t in TIME_CONSTANTS)
    return Correlation((0.0, 0.0, 0.0), shares, lasting)


def times_of(ticks: int) -> NDArray[np.float64]:
    return np.linspace(0.0, DT * (ticks - 1), ticks)


def residuals_of(tau: float, ticks: int, seed: int = 1) -> NDArray[np.float64]:
    """Two measurements whose errors have the correlation exp(-lag / tau)."""
    rng = np.random.default_rng(seed)
    ratio = math.exp(-DT / tau)
    noise = rng.normal(size=(ticks, 2)) * math.sqrt(1.0 - ratio * ratio)
    noise[0] /= math.sqrt(1.0 - ratio * ratio)
    for tick in range(1, ticks):
        noise[tick] += ratio * noise[tick - 1]
    return noise


@pytest.mark.parametrize(
    ("correlation", "seconds"),
    [
        (WHITE, DT),
        (Correlation((0.0, 1.0, 0.0), NONE, 0.0), 2.0 * DT),
        (Correlation((0.0, 0.0, 1.0), NONE, 0.0), 0.0),
        (Correlation((0.25, 0.5, 0.0), NONE, 0.25), 1.25 * DT),
    ],
)
def test_time_per_independent_error(correlation: Correlation, seconds: float) -> None:
    assert correlation.time_per_sample(DT) == pytest.approx(seconds)


@pytest.mark.parametrize("tau", TIME_CONSTANTS)
def test_time_per_error_is_the_sum_of_the_autocorrelation(tau: float) -> None:
    expected = DT * sum(math.exp(-abs(k) * DT / tau) for k in range(-4000, 4001))
    assert exponential(tau).time_per_sample(DT) == pytest.approx(expected)
    half = exponential(tau, lasting=0.5)
    assert half.time_per_sample(DT) == pytest.approx(0.5 * expected)


@pytest.mark.parametrize("ticks", [1, 2, 7, 40])
def test_the_spread_is_the_double_sum_over_all_ticks(ticks: int) -> None:
    rng = np.random.default_rng(ticks)
    gradients = rng.normal(size=(ticks, 3, 2))
    times = np.cumsum(rng.uniform(0.5, 1.5, ticks)) * DT
    mixed = Correlation((0.1, 0.2, 0.05), (0.1, 0.0, 0.3, 0.0, 0.0, 0.15), 0.1)
    for correlation in (WHITE, exponential(0.4), mixed):
        expected = np.zeros((2, 2))
        for i in range(ticks):
            for j in range(ticks):
                share = correlation.neighbours[0] * (i == j)
                share += (correlation.neighbours[1]) * {0: 1.0, 1: 0.5}.get(abs(i - j), 0.0)
                share += (correlation.neighbours[2]) * {0: 1.0, 1: -0.5}.get(abs(i - j), 0.0)
                for part, tau in zip(correlation.exponential, TIME_CONSTANTS, strict=True):
                    share += part * math.exp(-abs(times[i] - times[j]) / tau)
                expected += share * gradients[i].T @ gradients[j]
        spread = random_spread(times, gradients, correlation)
        assert spread == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("tau", [0.05, 0.2, 0.8])
def test_an_exponential_correlation_is_found(tau: float) -> None:
    ticks = 6000
    times = times_of(ticks)
    correlation = estimate_correlation(times, residuals_of(tau, ticks), np.ones(ticks), 2.0)
    assert correlation.lasting == 0.0
    expected = exponential(tau).time_per_sample(DT)
    assert correlation.time_per_sample(DT) == pytest.approx(expected, rel=0.35)


def test_white_errors_stay_white() -> None:
    ticks = 6000
    times = times_of(ticks)
    rng = np.random.default_rng(3)
    weights = rng.uniform(0.5, 2.0, ticks)
    residuals = rng.normal(size=(ticks, 2)) / np.sqrt(weights)[:, None]
    correlation = estimate_correlation(times, residuals, weights, 2.0)
    assert correlation.neighbours[0] > 0.9
    assert correlation.time_per_sample(DT) == pytest.approx(DT, rel=0.3)


def test_a_constant_error_lasts() -> None:
    ticks = 3000
    times = times_of(ticks)
    residuals = residuals_of(0.05, ticks)
    residuals += np.array([1.0, -1.0])
    correlation = estimate_correlation(times, residuals, np.ones(ticks), 2.0)
    assert correlation.lasting == pytest.approx(0.5, abs=0.2)


def test_pairs_of_ticks_over_a_gap_do_not_count() -> None:
    """The sign of the errors changes in each gap; without the gaps they would be constant."""
    ticks = 1200
    number = np.arange(ticks)
    times = times_of(ticks) + 5.0 * (number // 20)
    residuals = np.where(number // 20 % 2, 1.0, -1.0)[:, None] * np.ones((1, 2))
    correlation = estimate_correlation(times, residuals, np.ones(ticks), 2.0)
    assert correlation.time_per_sample(DT) + correlation.lasting > 0.3
    assert correlation.neighbours[0] < 0.1


@pytest.mark.parametrize(
    ("residuals", "redundancy"),
    [
        (np.ones((9, 2)), 2.0),
        (np.ones((100, 0)), 2.0),
        (np.ones((100, 2)), 0.0),
        (np.zeros((100, 2)), 2.0),
    ],
)
def test_logs_from_which_nothing_follows(residuals: NDArray[np.float64], redundancy: float) -> None:
    ticks = len(residuals)
    times = times_of(ticks)
    assert estimate_correlation(times, residuals, np.ones(ticks), redundancy) == WHITE
