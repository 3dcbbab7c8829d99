"""Wheel odometry: from joint states to the twist and the pose, with covariances."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator, TwistEstimate
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, ZERO_TWIST, Cov3, Pose2

LONGEST_INTERVAL = 0.5
"""Interval (s) between joint states above which the motion in between is unknown."""
_LOW_RANK_CORRELATION = 10.0
"""Time constant (s) of errors in directions of motion that no wheel measures."""


class Odometry:
    """Integrates the twist estimates of a calculator to a pose.

    ``estimate``: the mean twist of the last interval.  ``pose``: of ``base_link`` in the odometry
    frame.  ``covariance``: of the pose, as a small motion in ``base_link``; it grows while joint
    states are missing.  ``covariance_at_joints``: the covariance at the last joint states,
    ``joints``.  ``calculator`` may be exchanged between two updates; the pose stays.
    ``top_speeds`` (m/s, rad/s): bound of the motion while joint states are missing.
    """

    def __init__(self, calculator: BaseCalculator, top_speeds: tuple[float, float]) -> None:
        self.calculator = calculator
        self.top_speeds = top_speeds
        self.estimate = TwistEstimate(ZERO_TWIST, ZERO_COV, 0)
        self.pose = ORIGIN
        self.covariance = ZERO_COV
        self.joints: JointStates | None = None
        self.covariance_at_joints = ZERO_COV
        self._time = -math.inf

    def reset(self, pose: Pose2 = ORIGIN) -> None:
        """Sets the pose, with a covariance of zero."""
        self.pose = pose
        self.covariance = self.covariance_at_joints = ZERO_COV

    def update(self, joints: JointStates, now: float) -> None:
        """Integrates the motion up to the joint states read at ``now`` (s, monotonic).

        Between two joint states the robot moves with their mean twist.  After more than
        ``LONGEST_INTERVAL``, and if the time of the joints decreases, the motion is unknown: the
        pose stays and its covariance grows by the largest possible motion.  Joint states
        with the same time again count as missing.  Raises ``ValueError``
        (``NotFiniteError`` for a NaN) for unusable joint states, and then changes nothing.
        """
        previous = self.joints
        if previous is None:
            estimate = self.calculator.odometry(joints)
            self.store(joints, now, estimate, self.pose, self.covariance_at_joints)
            return
        if joints is previous and now == self._time:
            return  # a batch of several robots has integrated them
        elapsed = joints.time - previous.time
        if elapsed == 0.0:
            self.calculator.estimator.check(joints)
            self.mark_missing(now)
            return
        if not 0.0 < elapsed <= LONGEST_INTERVAL:
            estimate = self.calculator.odometry(joints)
            covariance = self._unknown_motion(max(elapsed, now - self._time))
            self.store(joints, now, estimate, self.pose, covariance)
            return
        self.calculator.estimator.check(joints)
        estimate = self.calculator.odometry(_mean_states(previous, joints, elapsed))
        correlation = self.calculator.estimator.noise.correlation
        if estimate.rank < 3:
            correlation = max(correlation, _LOW_RANK_CORRELATION)
        covariance = se2.propagate(
            self.covariance_at_joints, estimate.twist, estimate.covariance, elapsed, correlation
        )
        pose = self.pose.moved(se2.exp(estimate.twist, elapsed))
        self.store(joints, now, estimate, pose, covariance)

    def mark_missing(self, now: float) -> None:
        """Increases the covariance, because there are no joint states at ``now``."""
        if self.joints is not None:
            self.covariance = self._unknown_motion(now - self._time)

    def store(
        self,
        joints: JointStates,
        now: float,
        estimate: TwistEstimate,
        pose: Pose2,
        covariance: Cov3,
    ) -> None:
        """Stores the results for the joint states read at ``now``."""
        self.joints = joints
        self.estimate = estimate
        self.pose = pose
        self.covariance = self.covariance_at_joints = covariance
        self._time = now

    def _unknown_motion(self, time: float) -> Cov3:
        """Returns the covariance after ``time`` s of unknown motion within the top speeds."""
        way = (self.top_speeds[0] * time) ** 2
        turn = (self.top_speeds[1] * time) ** 2
        (a, b, c), (_, d, e), (_, _, f) = self.covariance_at_joints
        return ((a + way, b, c), (b, d + way, e), (c, e, f + turn))


def _mean_states(start: JointStates, end: JointStates, dt: float) -> JointStates:
    """Returns the mean joint states of an interval.

    Wheel speeds are differences of the positions, if the base measures positions.

    Each angle contributes to two intervals, with half of its error to each.  The error of a sum
    over many intervals is then as large as with an independent error of full size in each
    interval, which is what the covariance of the pose assumes.
    """
    if start.positions is not None and end.positions is not None:
        speeds = [(b - a) / dt for a, b in zip(start.positions, end.positions, strict=True)]
    else:
        speeds = _means(start.speeds, end.speeds)
    rates = [(b - a) / dt for a, b in zip(start.angles, end.angles, strict=True)]
    yaw_rate = end.yaw_rate
    if yaw_rate is not None and start.yaw_rate is not None:
        yaw_rate = (start.yaw_rate + yaw_rate) / 2.0
    angles = _means(start.angles, end.angles)
    return JointStates(end.time, speeds, angles, rates, None, yaw_rate)


def _means(start: Sequence[float], end: Sequence[float]) -> list[float]:
    return [(a + b) / 2.0 for a, b in zip(start, end, strict=True)]
