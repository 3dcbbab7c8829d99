"""The odometry of many robots of one kind in a few array operations.

A hundred robots in one scene are read at the same time.  What their joints tell is the same
mathematics for each, so it is done for all at once (``calculators.batch``): equal to
``Odometry.update``, robot by robot, to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator, TwistEstimate
from thorvaldc.runtime.odometry import LONGEST_INTERVAL, Odometry
from thorvaldc.runtime.se2 import Cov3, Pose2, Turn, Twist, propagated
from thorvaldc.simulation.vectorised.calculator_batch import Array, CalculatorBatch

_SHORTEST = 1e-4
"""Time (s) below which differences of joint states may be beyond all bounds."""
_BEYOND = 1e9
"""Numbers (SI) of a joint that are looked at one by one."""


class OdometryBatch:
    """The odometry of robots of one kind; ``calculator`` is that of one of them.

    Of a kind they are with the same wheels, noise and options, whose calculator leaves odometry
    to its estimator, and whose wheels tell the whole twist at any angle.

    Arrays have a column for each robot: what its ``Odometry`` held when it was last here.
    """

    def __init__(self, calculator: BaseCalculator, odometries: Sequence[Odometry]) -> None:
        self._batch = CalculatorBatch(calculator)
        self._correlation = calculator.estimator.noise.correlation
        self._odometries = odometries
        n, wheels = len(odometries), self._batch.wheels
        self._wheels = wheels
        self._times = np.zeros(n)
        self._joints = np.zeros((2, wheels, n))  # positions and steering angles, rad
        self._poses = np.zeros((3, n))
        self._known = np.zeros((6, n))
        # What the columns were made of, to see whether an odometry has changed since.
        self._held: list[tuple[JointStates, Pose2, Cov3] | None] = [None] * n

    def update(self, joints: Sequence[JointStates], now: float) -> None:
        """As ``update`` of each, but those with whom anything is unusual are left alone."""
        some = [k for k, states in enumerate(joints) if self._usual(k, states)]
        if not some:
            return
        table = np.fromiter(
            chain.from_iterable(chain.from_iterable(_numbers(joints[k]) for k in some)), float
        ).reshape(len(some), 4, self._wheels)
        sound = (np.abs(table) < _BEYOND).all(axis=(1, 2))  # which no NaN is
        if not sound.all():
            some = [k for k, good in zip(some, sound.tolist(), strict=True) if good]
            table = table[sound]
        if some:
            positions_and_angles = np.ascontiguousarray(table[:, :2].transpose(1, 2, 0))
            self._take(some, joints, positions_and_angles, now)

    def _usual(self, k: int, states: JointStates) -> bool:
        odometry, held = self._odometries[k], self._held[k]
        before = odometry.joints
        if (
            before is None
            or before.positions is None
            or states.positions is None
            or states.yaw_rate is not None
            or not len(states.positions) == len(states.angles) == self._wheels
            or not len(states.speeds) == len(states.angle_rates) == self._wheels
            or not _SHORTEST <= states.time - before.time <= LONGEST_INTERVAL
        ):
            return False
        if (
            held is None
            or held[0] is not before
            or held[1] is not odometry.pose
            or held[2] is not odometry.known
        ):
            self._times[k] = before.time
            self._joints[:, :, k] = before.positions, before.angles
            self._poses[:, k] = odometry.pose
            self._known[:, k] = _upper(odometry.known)
        return True

    def _take(
        self, some: list[int], joints: Sequence[JointStates], after: Array, now: float
    ) -> None:
        n = len(some)
        before, times = self._joints[:, :, some], np.array([joints[k].time for k in some])
        dt = times - self._times[some]
        speeds, rates = (after - before) / dt
        angles = (before[1] + after[1]) / 2.0
        twists, noise, tests = np.empty((3, n)), np.empty((6, n)), np.empty((self._wheels, n))
        dropped = self._batch.estimate(speeds, angles, twists, noise, tests, rates)
        dx, dy, angle = twists * dt
        turn = _turn(angle)
        poses = _moved(self._poses[:, some], dx, dy, angle, turn)
        d2 = dt * dt
        if self._correlation > 0.0:
            d2 /= np.tanh(dt / (2.0 * self._correlation))
        before_known = _whole(self._known[:, some])
        known = np.array(_upper(propagated(before_known, _whole(noise), dx, dy, turn, d2)))
        self._times[some], self._joints[:, :, some] = times, after
        self._poses[:, some], self._known[:, some] = poses, known
        columns = [array.T.tolist() for array in (twists, noise, tests, poses, known)]
        for i, (k, twist, q, test, pose, p) in enumerate(zip(some, *columns, strict=True)):
            estimate = TwistEstimate(Twist(*twist), _whole(q), 3, tuple(test), dropped.get(i, ()))
            states, there, covariance = self._held[k] = joints[k], Pose2(*pose), _whole(p)
            self._odometries[k].take(states, now, estimate, there, covariance)


def _numbers(states: JointStates) -> tuple[Sequence[float], ...]:
    return states.positions or (), states.angles, states.speeds, states.angle_rates


def _moved(poses: Array, dx: Array, dy: Array, angle: Array, turn: Turn) -> Array:
    """``Pose2.moved`` by the step that ``se2.exp`` gives."""
    x, y = turn.s1 * dx - turn.c1 * dy, turn.c1 * dx + turn.s1 * dy
    c, s = np.cos(poses[2]), np.sin(poses[2])
    return np.array([poses[0] + c * x - s * y, poses[1] + s * x + c * y, poses[2] + angle])


def _turn(angle: Array) -> Turn:
    small = np.abs(angle) < 1e-3
    a = np.where(small, 1.0, angle)
    s, half = np.sin(a), np.sin(a / 2.0)
    square, versin = angle * angle, 2.0 * half * half
    return Turn(
        np.cos(angle),
        np.sin(angle),
        np.where(small, 1.0 - square / 6.0 * (1.0 - square / 20.0), s / a),
        np.where(small, angle / 2.0 * (1.0 - square / 12.0), versin / a),
        np.where(small, angle / 6.0, (a - s) / (a * a)),
        np.where(small, 0.5, versin / (a * a)),
    )


def _upper(covariance: Any) -> tuple[Any, ...]:
    (a, b, c), (_, d, e), (_, _, f) = covariance
    return a, b, c, d, e, f


def _whole(upper: Any) -> Any:
    a, b, c, d, e, f = upper
    return (a, b, c), (b, d, e), (c, e, f)
