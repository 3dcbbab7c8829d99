"""A joint log as arrays of its intervals: mean speeds and angles between two lines."""

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
"""Number of ticks used at most; of a longer log every n-th tick."""
MIN_SPEED = 0.05
"""Least mean speed (m/s) of the wheels of a tick in motion."""


class Ticks:
    """Mean joint states of the intervals between the log's lines, one column per wheel.

    ``speeds`` (rad/s), ``angles`` (rad, encoder readings) and ``turning`` (rad/s, steering rate);
    0 for a wheel without that encoder.  ``valid``: masks intervals that are not too long.
    ``moving``: masks valid intervals in motion.
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

    def select(self, mask: NDArray[np.bool_] | NDArray[np.intp]) -> Ticks:
        """Returns the ticks of a mask or of indices."""
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
        """Returns the ticks in motion, at most ``MAX_TICKS`` of them."""
        index = np.flatnonzero(self.moving)
        return self.select(index[:: math.ceil(len(index) / MAX_TICKS)])


def _means(values: Sequence[float]) -> Array:
    array: Array = np.array(values, dtype=float)
    return np.asarray((array[1:] + array[:-1]) / 2.0)
