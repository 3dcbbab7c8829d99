"""A joint log as arrays: what each interval between two of its lines tells."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thorvaldc.model import Robot
from thorvaldc.runtime.odometry import LONGEST_INTERVAL
from thorvaldc.simulation.records.joint_csv import JointLog

Array = NDArray[np.float64]

MOST_TICKS = 20000
"""Ticks that are used; of a longer log every n-th."""
MOVES = 0.05
"""Mean speed (m/s) of the wheels over ground from which on they tell something."""


class Ticks:
    """Means over the intervals between the log's lines, one column per wheel.

    ``speeds`` (rad/s) and ``turning`` (rad/s, of the steering) are 0 and ``angles``
    (rad, encoders' readings) too where a wheel has no such encoder.
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
        self.whole = self.dt <= LONGEST_INTERVAL
        radii = np.array([wheel.radius for wheel in robot.wheels])
        self.moves = self.whole & (np.sqrt(np.mean((self.speeds * radii) ** 2, axis=1)) > MOVES)

    def chosen(self, mask: NDArray[np.bool_] | NDArray[np.intp]) -> Ticks:
        other = object.__new__(Ticks)
        other.times = self.times[:-1][mask]
        other.dt, other.whole, other.moves = self.dt[mask], self.whole[mask], self.moves[mask]
        other.speeds, other.angles = self.speeds[mask], self.angles[mask]
        other.turning, other.wheel_of = self.turning[mask], self.wheel_of
        return other

    def thinned(self) -> Ticks:
        """Those in motion, of very many every n-th."""
        index = np.flatnonzero(self.moves)
        return self.chosen(index[:: math.ceil(len(index) / MOST_TICKS)])


def _means(values: Sequence[float]) -> Array:
    array: Array = np.array(values, dtype=float)
    return np.asarray((array[1:] + array[:-1]) / 2.0)
