"""Computes the odometry of many identical robots in a few array operations.

The robots of a scene read their joints at the same time, and the same odometry equations apply to
identical robots.  The results equal the results of ``Odometry.update`` for each robot, except for
rounding errors.
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

_MIN_INTERVAL = 1e-4
"""Shortest interval (s) between joint states, because rates over shorter intervals may overflow."""
_MAX_VALUE = 1e9
"""Joint states (SI units) from this limit on are left to the scalar odometry."""


class OdometryBatch:
    """Odometry of several robots with the same wheels, noise and calculator options.

    ``calculator`` is the base calculator of any robot in the batch.  The calculator must use the
    method ``BaseCalculator.odometry`` without changes.  The wheels of the robots must determine the
    whole twist at any steering angles.

    Each array of the batch has one column per robot.  The columns of a robot contain a copy of its
    ``Odometry`` after the last update.
    """

    def __init__(self, calculator: BaseCalculator, odometries: Sequence[Odometry]) -> None:
        self._batch = CalculatorBatch(calculator)
        self._odometries = odometries
        n, wheels = len(odometries), self._batch.wheels
        self._wheels = wheels
        self._times = np.zeros(n)
        self._joints = np.zeros((2, wheels, n))  # positions and steering angles, rad
        self._poses = np.zeros((3, n))
        self._covariances = np.zeros((6, n))
        # Objects in the odometry of each robot from which the array columns were copied.  If the
        # odometry of a robot contains other objects, code outside of the batch has changed the
        # odometry.
        self._copied: list[tuple[JointStates, Pose2, Cov3] | None] = [None] * n

    def update(self, joints: Sequence[JointStates], now: float) -> None:
        """Updates the odometry of each robot with the robot's joint states.

        Robots with unusual joint states are left out.  Joint states are unusual if wheel positions
        are missing, if the joint states contain a yaw rate, if the interval since the last joint
        states is too short or too long, or if a joint state is very large or not finite.
        """
        robots = [k for k, states in enumerate(joints) if self._is_usual(k, states)]
        if not robots:
            return
        table = np.fromiter(
            chain.from_iterable(chain.from_iterable(_values(joints[k]) for k in robots)), float
        ).reshape(len(robots), 4, self._wheels)
        valid = (np.abs(table) < _MAX_VALUE).all(axis=(1, 2))  # also false for NaN
        if not valid.all():
            robots = [k for k, good in zip(robots, valid.tolist(), strict=True) if good]
            table = table[valid]
        if robots:
            positions_and_angles = np.ascontiguousarray(table[:, :2].transpose(1, 2, 0))
            self._integrate(robots, joints, positions_and_angles, now)

    def _is_usual(self, k: int, states: JointStates) -> bool:
        odometry, copied = self._odometries[k], self._copied[k]
        previous = odometry.joints
        if (
            previous is None
            or previous.positions is None
            or states.positions is None
            or states.yaw_rate is not None
            or not len(states.positions) == len(states.angles) == self._wheels
            or not len(states.speeds) == len(states.angle_rates) == self._wheels
            or not _MIN_INTERVAL <= states.time - previous.time <= LONGEST_INTERVAL
        ):
            return False
        if (
            copied is None
            or copied[0] is not previous
            or copied[1] is not odometry.pose
            or copied[2] is not odometry.covariance_at_joints
        ):
            self._times[k] = previous.time
            self._joints[:, :, k] = previous.positions, previous.angles
            self._poses[:, k] = odometry.pose
            self._covariances[:, k] = _upper(odometry.covariance_at_joints)
        return True

    def _integrate(
        self, robots: list[int], joints: Sequence[JointStates], end: Array, now: float
    ) -> None:
        """Integrates the motion of all robots over the interval between two joint states.

        ``end`` contains the positions of the spin joints and the steering angles at the end of the
        interval, in rad.  The shape of ``end`` is (2, wheels, robots).
        """
        n = len(robots)
        start, times = self._joints[:, :, robots], np.array([joints[k].time for k in robots])
        dt = times - self._times[robots]
        speeds, rates = (end - start) / dt
        angles = (start[1] + end[1]) / 2.0
        twists, noise, tests = np.empty((3, n)), np.empty((6, n)), np.empty((self._wheels, n))
        suspects: dict[int, tuple[int, ...]] = {}
        dropped = self._batch.estimate(
            speeds,
            angles,
            twists,
            noise,
            tests,
            rates,
            commanded=lambda i: self._odometries[robots[i]].calculator.commanded_speeds,
            suspects=suspects,
        )
        dx, dy, angle = twists * dt
        turn = _turn(angle)
        poses = _moved(self._poses[:, robots], dx, dy, angle, turn)
        covariances = _full(self._covariances[:, robots])
        grown = propagated(covariances, _full(noise), dx, dy, turn, dt * dt)
        new_covariances = np.array(_upper(grown))
        self._times[robots], self._joints[:, :, robots] = times, end
        self._poses[:, robots], self._covariances[:, robots] = poses, new_covariances
        columns = [array.T.tolist() for array in (twists, noise, tests, poses, new_covariances)]
        for i, (k, twist, q, test, pose, p) in enumerate(zip(robots, *columns, strict=True)):
            estimate = TwistEstimate(
                Twist(*twist), _full(q), 3, tuple(test), dropped.get(i, ()), suspects.get(i, ())
            )
            states, new_pose, covariance = self._copied[k] = joints[k], Pose2(*pose), _full(p)
            self._odometries[k].store(states, now, estimate, new_pose, covariance)


def _values(states: JointStates) -> tuple[Sequence[float], ...]:
    return states.positions or (), states.angles, states.speeds, states.angle_rates


def _moved(poses: Array, dx: Array, dy: Array, angle: Array, turn: Turn) -> Array:
    """Moves an array of robot poses by the motion of a constant twist.

    The result equals ``Pose2.moved`` with the step from ``se2.exp``.
    """
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


def _full(upper: Any) -> Any:
    a, b, c, d, e, f = upper
    return (a, b, c), (b, d, e), (c, e, f)
