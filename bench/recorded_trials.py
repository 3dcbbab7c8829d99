"""Recorded trials of ``broken_world``: what a driver sees of a robot, and the truth."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime.base_interface import JointStates

Array = NDArray[np.float64]


class Recording(NamedTuple):
    """Trials of a family and a class: n ticks of w wheels.

    - ``times`` (n): s.
    - ``speeds``, ``angles``, ``rates``, ``positions`` (trials, n, w): joint states in rad and s.
    - ``commanded`` (trials, n, w): commanded speeds (rad/s) when the driver read these states.
    - ``torques`` (trials, n, w): torques of the drives relative to their limits.
    - ``poses`` (trials, n, 3): true pose of ``base_link``; the yaw is not wrapped.
    - ``yaw_rates`` (trials, n): true yaw rate, rad/s.
    - ``breaks`` (trials): tick of the break.
    - ``ends`` (trials): last tick before the robot tips over, or the last tick.
    - ``changes`` (trials): text of the ``Break``.
    """

    times: Array
    speeds: Array
    angles: Array
    rates: Array
    positions: Array
    commanded: Array
    torques: Array
    poses: Array
    yaw_rates: Array
    breaks: NDArray[np.int64]
    ends: NDArray[np.int64]
    changes: NDArray[np.str_]

    def joint_states(self, trial: int, gyro: Array | None) -> list[JointStates]:
        """Returns the joint states of a trial; ``gyro`` (n): measured yaw rates (rad/s)."""
        return [
            JointStates(
                time,
                self.speeds[trial, k].tolist(),
                self.angles[trial, k].tolist(),
                self.rates[trial, k].tolist(),
                self.positions[trial, k].tolist(),
                None if gyro is None else float(gyro[k]),
            )
            for k, time in enumerate(self.times[: self.ends[trial] + 1].tolist())
        ]

    def true_twists(self) -> Array:
        """Returns the mean twists (trials, n - 1, 3) of the true motion between two ticks."""
        change = np.diff(self.poses, axis=1)
        yaw = self.poses[:, :-1, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        x, y, turn = np.moveaxis(change, -1, 0)
        motions = np.stack([c * x + s * y, c * y - s * x, turn], axis=-1)
        twists: Array = logarithm(motions) / np.diff(self.times)[:, np.newaxis]
        return twists

    def save(self, path: Path) -> None:
        np.savez_compressed(path, **self._asdict())

    @classmethod
    def load(cls, path: Path) -> Recording:
        with np.load(path) as arrays:
            return cls(**{name: arrays[name] for name in cls._fields})


def logarithm(motions: Array) -> Array:
    """Returns the smallest twists (..., 3) that cause these relative poses within 1 s."""
    x, y, yaw = np.moveaxis(motions, -1, 0)
    yaw = np.remainder(yaw + np.pi, 2.0 * np.pi) - np.pi
    half = yaw / 2.0
    k = np.where(np.abs(half) > 1e-6, half / np.tan(np.where(half, half, 1.0)), 1.0)
    return np.stack([k * x + half * y, k * y - half * x, yaw], axis=-1)
