"""The joint log of a calibration: its intervals, its errors over time, and the log that is missing.

``Ticks`` are the mean joint states between successive lines of the log.

Errors from ground and tyres last longer than a tick.  The sum of n correlated errors has a larger
variance than the sum of n independent errors, so that the standard error of an estimate is larger.
The autocorrelation rho(t) of the errors, from the residuals of the fit, is a mixture of known
shapes:

    rho(t) = sum_j share_j shape_j(t) + lasting exp(-t / LASTING_TIME)

- Three shapes for errors without memory: white, and the correlations +0.5 and -0.5 between
  neighbouring ticks.  A tick contains the mean of two successive angles (+0.5), or the difference
  of two successive positions (-0.5).
- Exponential shapes exp(-t / tau) with the time constants ``TIME_CONSTANTS``.
- A lasting part, which changes with the motion of the robot, in seconds.

Errors of the first two kinds are random: a longer log reduces them.  Errors of the lasting part are
systematic, such as the side slip of a wheel in a turn: they return with each turn, and a longer log
does not reduce them.

``plan_motions`` plans a log that settles the values that a first log leaves open.  The information
of a steady motion about the parameters does not depend on measured values, only on the directions
of the wheels.  The plan adds seconds of simple motions to the information of the log, always of the
motion that reduces the largest open standard error most, until all values are settled (greedy
E-optimal design).  The noise is that of the log.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thorvaldc.model import Robot
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.calculators import for_robot
from thorvaldc.runtime.calculators.base_calculator import BaseCalculator
from thorvaldc.runtime.odometry import LONGEST_INTERVAL
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.records.joint_csv import JointLog

Array = NDArray[np.float64]

MAX_TICKS = 20000
"""Largest number of ticks that the calibration uses.

If a log has more ticks, the calibration uses only every n-th tick.
"""
MIN_SPEED = 0.05
"""The robot counts as moving if the mean wheel speed (m/s) in a tick is at least this speed."""


class Ticks:
    """Mean joint states of the intervals (ticks) between successive lines of a joint log.

    The arrays have one row per tick and one column per wheel.

    - ``times``: times of the lines of the joint log, s.
    - ``dt``: durations of the intervals, s.
    - ``speeds``: wheel speeds in rad/s, or 0 for a wheel without encoder.
    - ``angles``: readings of the steering encoders in rad, or 0 for a wheel without steering
      encoder.
    - ``turning``: steering rates in rad/s, or 0 for a wheel without steering encoder.
    - ``valid``: mask of the intervals that are not too long.
    - ``moving``: mask of the valid intervals in which the robot moves.
    - ``wheel_of``: index of the wheel for each spin joint.
    """

    def __init__(self, robot: Robot, log: JointLog) -> None:
        times = np.array(log.times, dtype=float)
        n = len(robot.wheels)
        self.times = times
        self.dt = np.diff(times)
        self.wheel_of = {w.spin_joint: i for i, w in reversed(list(enumerate(robot.wheels)))}
        shape = (len(self.dt), n)
        self.speeds, self.angles, self.turning = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        for i, wheel in enumerate(robot.wheels):
            if wheel.spin_joint in log.positions:
                self.speeds[:, i] = np.diff(log.positions[wheel.spin_joint]) / self.dt
            elif wheel.spin_joint in log.velocities:
                self.speeds[:, i] = _means(log.velocities[wheel.spin_joint])
            if wheel.steering_joint in log.angles:
                angles = log.angles[wheel.steering_joint]
                self.angles[:, i] = _means(angles)
                self.turning[:, i] = np.diff(angles) / self.dt
        self.valid = self.dt <= LONGEST_INTERVAL
        radii = np.array([wheel.radius for wheel in robot.wheels])
        self.moving = self.valid & (
            np.sqrt(np.mean((self.speeds * radii) ** 2, axis=1)) > MIN_SPEED
        )

    @classmethod
    def steady(cls, speeds: Array, angles: Array) -> Ticks:
        """Returns one tick of 1 s for each row of constant wheel speeds and steering angles."""
        ticks = object.__new__(cls)
        ticks.times = np.arange(float(len(speeds)))
        ticks.dt = np.ones(len(speeds))
        ticks.speeds, ticks.angles, ticks.turning = speeds, angles, np.zeros_like(angles)
        ticks.valid = ticks.moving = np.ones(len(speeds), dtype=bool)
        ticks.wheel_of = {}
        return ticks

    def select(self, mask: NDArray[np.bool_] | NDArray[np.intp]) -> Ticks:
        """Returns only the ticks that a boolean mask or an array of indices selects."""
        selected = object.__new__(Ticks)
        selected.times = self.times[:-1][mask]
        selected.dt, selected.valid, selected.moving = (
            self.dt[mask],
            self.valid[mask],
            self.moving[mask],
        )
        selected.speeds, selected.angles = self.speeds[mask], self.angles[mask]
        selected.turning, selected.wheel_of = self.turning[mask], self.wheel_of
        return selected

    def thinned(self) -> Ticks:
        """Returns the ticks in which the robot moves, reduced to at most ``MAX_TICKS`` ticks."""
        index = np.flatnonzero(self.moving)
        return self.select(index[:: math.ceil(len(index) / MAX_TICKS)])


def _means(values: Sequence[float]) -> Array:
    array: Array = np.array(values, dtype=float)
    return np.asarray((array[1:] + array[:-1]) / 2.0)


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


SPEED = 0.5
"""Speed (m/s) of the planned motions."""
LONGEST = 1800.0
"""A log that must be longer than this time (s) is not planned."""
_STEP = 10.0  # s
_GROWTH = 0.15
_SAME = 1e-3
"""Twists within this distance (m/s, rad/s) are equal."""


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """A motion of a log that settles open values: a description and a duration in s."""

    description: str
    seconds: float


@dataclass(frozen=True, slots=True)
class SteadyMotion:
    """A motion with constant joints: wheel speeds (rad/s) and steering angles (rad) by wheel."""

    description: str
    twists: tuple[Twist, ...]
    speeds: Array
    angles: Array


def steady_motions(robot: Robot, length: float) -> Iterator[SteadyMotion]:
    """Yields the simple motions that the robot can make.

    ``length`` is a length (m) of the order of the wheelbase.
    """
    calculator = for_robot(robot)
    near, wide = SPEED / (1.5 * length), SPEED / (5.0 * length)
    for description, twists in (
        ("straight on", [(SPEED, 0.0, 0.0)]),
        ("sideways", [(0.0, SPEED, 0.0)]),
        ("diagonally, to both sides", [(0.7 * SPEED, y * SPEED, 0.0) for y in (0.7, -0.7)]),
        ("in wide circles to both sides", [(SPEED, 0.0, wide), (SPEED, 0.0, -wide)]),
        ("in narrow circles to both sides", [(SPEED, 0.0, near), (SPEED, 0.0, -near)]),
        ("on the spot, in both directions", [(0.0, 0.0, 1.5 * near), (0.0, 0.0, -1.5 * near)]),
    ):
        feasible = [calculator.feasible(Twist(*twist)) for twist in twists]
        states = [
            _joints(calculator, twist) if _similar(twist, Twist(*commanded)) else None
            for twist, commanded in zip(feasible, twists, strict=True)
        ]
        reachable = [state for state in states if state is not None]
        if len(reachable) == len(twists):
            yield SteadyMotion(
                description,
                tuple(feasible),
                np.array([speeds for speeds, _ in reachable]),
                np.array([angles for _, angles in reachable]),
            )


def _similar(twist: Twist, commanded: Twist) -> bool:
    """Returns whether a feasible twist keeps most of the commanded velocity and yaw rate."""
    along = twist.vx * commanded.vx + twist.vy * commanded.vy
    turning = twist.wz * commanded.wz
    return along >= 0.5 * commanded.speed**2 and turning >= 0.5 * commanded.wz**2


def _joints(
    calculator: BaseCalculator, twist: Twist
) -> tuple[Sequence[float], Sequence[float]] | None:
    """Returns wheel speeds and steering angles for a twist, or ``None`` if it is not reachable."""
    command = calculator.command(twist)
    missed = max(abs(a - b) for a, b in zip(command.target, twist, strict=True))
    if command.unreachable or missed > _SAME:
        return None
    return command.joints.speeds, command.joints.angles


def plan_motions(
    covariance: Array,
    targets: Array,
    limits: Array,
    candidates: Sequence[tuple[str, Array]],
) -> tuple[PlannedMotion, ...] | None:
    """Returns the motions after which all target variances are at most their limits.

    - ``covariance``: covariance of the parameters after the first log.
    - ``targets``: one row per open value; its value is the product of the row and the parameters.
    - ``limits``: largest settled variance of each open value.
    - ``candidates``: description and information matrix per second of each motion.

    Returns ``None`` if no motions of at most ``LONGEST`` s settle all open values.
    """
    # Errors below 1e-6 do not matter, and keep the matrix regular.
    information: Array = np.asarray(
        np.linalg.inv(covariance + 1e-12 * np.eye(len(covariance))), dtype=np.float64
    )
    seconds = [0.0] * len(candidates)

    def excess(matrix: Array) -> float:
        variances = np.einsum("op,pq,oq->o", targets, np.linalg.inv(matrix), targets)
        return float(np.max(variances / limits))

    while excess(information) > 1.0:
        total = float_sum(seconds)
        if total > LONGEST or not candidates:
            return None
        step = max(_STEP, _STEP * math.floor(_GROWTH * total / _STEP))
        scores = [excess(information + step * per_second) for _, per_second in candidates]
        best = int(np.argmin(scores))
        seconds[best] += step
        information = information + step * candidates[best][1]
    return tuple(
        PlannedMotion(description, duration)
        for (description, _), duration in zip(candidates, seconds, strict=True)
        if duration > 0.0
    )


def plan_text(motions: Sequence[PlannedMotion]) -> str:
    """Returns the motions as a text such as "20 s sideways and 35 s straight on"."""
    parts = [f"{motion.seconds:g} s {motion.description}" for motion in motions]
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
