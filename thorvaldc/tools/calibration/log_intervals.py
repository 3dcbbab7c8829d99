"""Converts a joint log to arrays of the mean joint states between successive lines of the log."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thorvaldc.model import Robot
from thorvaldc.runtime.odometry import LONGEST_INTERVAL
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
