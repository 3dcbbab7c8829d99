"""Fits of the twist under hypotheses about faulty wheels (see ``wheel_rejection``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from thorvaldc.runtime.calculators.twist_fit import (
    USE_ROLL,
    Fit,
    Measurement,
    NoiseSquares,
    NormalEquations,
    add_rolling_speed,
    fit_twist,
    unweighted_normal_equations,
)
from thorvaldc.runtime.se2 import Row3

_FOLLOWING = 0.03
"""Error of a wheel that follows its command, relative to the commanded speed."""
FOLLOWING_FLOOR = 0.015
"""Error (m/s) of a wheel that follows its command, in addition to the relative error.

A wheel that accelerates by 0.75 m/s^2 is so much slower than its command of the last tick.
"""


class HypothesisFits(NamedTuple):
    """Fits the twist to the measurements of a tick.

    - ``solve``: solves the unweighted normal equations.
    - ``squares``: variances from ``Noise.squares``.
    - ``prior``: prior information for measurements of trusted wheels.
    - ``weak_prior``: prior information if the trusted wheels may not determine the twist.
    - ``yaw_rate``: yaw rate (rad/s) that a gyro measures, or ``None`` without a gyro.
    - ``steps``: number of Gauss-Newton steps of ``refit``.
    - ``commanded``: commanded rolling speed (m/s) of the contact of each measured wheel, or empty
      if the commands are unknown.
    """

    solve: Callable[[NormalEquations, float | None], tuple[Row3, int]]
    squares: NoiseSquares
    prior: tuple[float, float]
    weak_prior: tuple[float, float]
    yaw_rate: float | None
    steps: int
    commanded: Sequence[float]

    def refit(self, measurements: list[Measurement], previous: Fit) -> Fit:
        """Fits with weights from a previous fit."""
        for _ in range(self.steps):
            vx, vy, wz = previous[:3]
            previous = fit_twist(measurements, vx, vy, wz, self.squares, self.prior, self.yaw_rate)
        return previous

    def anew(self, measurements: list[Measurement]) -> Fit:
        """Fits with weights from the unweighted fit of the same measurements.

        The weights of the healthy wheels are then independent of the faulty wheels.
        """
        (vx, vy, wz), _ = self.solve(unweighted_normal_equations(measurements), self.yaw_rate)
        first = fit_twist(measurements, vx, vy, wz, self.squares, self.prior, self.yaw_rate)
        return self.refit(measurements, first)

    def with_commands(self, measurements: list[Measurement], faulty: Sequence[int]) -> Fit:
        """Fits where the encoders of the wheels ``faulty`` are wrong.

        The commands, if known, measure the speeds of these wheels, with the errors of
        ``following_error``.  Speeds that nothing measures are 0 with the top speed as the standard
        deviation.
        """
        expected = measurements
        if self.commanded:
            # The weights need a twist that the faulty encoders do not influence.
            expected = [
                (m[0] | USE_ROLL, *m[1:5], self.commanded[k], *m[6:]) if k in faulty else m
                for k, m in enumerate(measurements)
            ]
        (vx, vy, wz), _ = self.solve(unweighted_normal_equations(expected), self.yaw_rate)
        fit = fit_twist(measurements, vx, vy, wz, self.squares, self.weak_prior, self.yaw_rate)
        if self.commanded:
            for k in faulty:
                speed = self.commanded[k]
                fit = add_rolling_speed(fit, k, speed, following_error(speed) ** 2)
        return fit

    def without_encoders(self, measurements: list[Measurement]) -> Fit:
        """Fits where all encoders are wrong."""
        encoders = [k for k, m in enumerate(measurements) if m[0] & USE_ROLL]
        return self.with_commands([(m[0] & ~USE_ROLL, *m[1:]) for m in measurements], encoders)


def following_error(speed: float) -> float:
    """Returns the largest error (m/s) of a wheel that follows its commanded speed (m/s)."""
    return FOLLOWING_FLOOR + _FOLLOWING * abs(speed)
