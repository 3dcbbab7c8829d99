"""Where the robot is by its wheels: joint states in, twist and pose with covariances out."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator, TwistEstimate
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, ZERO_TWIST, Cov3, Pose2

LONGEST_INTERVAL = 0.5
"""Time (s) beyond which joint states no longer tell the way between them."""
_UNKNOWN = 10.0
"""How long (s) a motion that no wheel sees is taken to go on as it is."""


class Odometry:
    """Integrates what a calculator makes of the joints.

    ``estimate`` is the mean twist over the last interval, ``pose`` that of
    ``base_link`` where it was last reset, ``covariance`` that of a small motion of it
    in itself; ``known`` is what that was at the last ``joints``.  ``calculator`` may be
    exchanged between two updates; the pose stays.
    ``fastest`` (m/s, rad/s): what the robot can have driven while nobody looked.
    """

    def __init__(self, calculator: BaseCalculator, fastest: tuple[float, float]) -> None:
        self.calculator = calculator
        self.fastest = fastest
        self.estimate = TwistEstimate(ZERO_TWIST, ZERO_COV, 0)
        self.pose = ORIGIN
        self.covariance = ZERO_COV
        self.joints: JointStates | None = None
        self.known = ZERO_COV
        self._at = -math.inf

    def reset(self, pose: Pose2 = ORIGIN) -> None:
        """Set the pose; its covariance starts again at zero."""
        self.pose = pose
        self.covariance = self.known = ZERO_COV

    def update(self, joints: JointStates, now: float) -> None:
        """Take in the joints read at ``now`` (s, monotonic).

        Between two joint states the robot drives their mean twist.  After more than
        ``LONGEST_INTERVAL``, and where their time goes back, the way is unknown: the
        pose stays and its covariance grows by what the robot can have driven.  The
        same joints again (their time stands) are as good as none.  Raises
        ``ValueError`` (``NotFiniteError`` for a NaN) for joints that cannot be
        used; nothing is changed then.
        """
        before = self.joints
        if before is None:
            self.take(joints, now, self.calculator.odometry(joints), self.pose, self.known)
            return
        if joints is before and now == self._at:
            return  # taken in already, with those of other robots
        elapsed = joints.time - before.time
        if elapsed == 0.0:
            self.calculator.estimator.check(joints)
            self.miss(now)
            return
        if not 0.0 < elapsed <= LONGEST_INTERVAL:
            estimate = self.calculator.odometry(joints)
            known = self._grown(max(elapsed, now - self._at))
            self.take(joints, now, estimate, self.pose, known)
            return
        self.calculator.estimator.check(joints)
        estimate = self.calculator.odometry(_between(before, joints, elapsed))
        correlation = self.calculator.estimator.noise.correlation
        if estimate.rank < 3:
            correlation = max(correlation, _UNKNOWN)
        known = se2.propagate(self.known, estimate.twist, estimate.covariance, elapsed, correlation)
        self.take(joints, now, estimate, self.pose.moved(se2.exp(estimate.twist, elapsed)), known)

    def miss(self, now: float) -> None:
        """There are no joints at ``now``: the covariance grows until there are."""
        if self.joints is not None:
            self.covariance = self._grown(now - self._at)

    def take(
        self, joints: JointStates, now: float, estimate: TwistEstimate, pose: Pose2, known: Cov3
    ) -> None:
        """Take over what was made of the joints read at ``now``."""
        self.joints = joints
        self.estimate = estimate
        self.pose = pose
        self.covariance = self.known = known
        self._at = now

    def _grown(self, time: float) -> Cov3:
        """The covariance after ``time`` s of any motion that the robot is capable of."""
        way = (self.fastest[0] * time) ** 2
        turn = (self.fastest[1] * time) ** 2
        (a, b, c), (_, d, e), (_, _, f) = self.known
        return ((a + way, b, c), (b, d + way, e), (c, e, f + turn))


def _between(before: JointStates, after: JointStates, dt: float) -> JointStates:
    """The mean joint states of an interval: speeds from the ways where they are counted.

    An angle serves two intervals, with half its error in each: that of their sum
    is as if it served one, which is what covariances take it for.
    """
    if before.positions is not None and after.positions is not None:
        speeds = [(b - a) / dt for a, b in zip(before.positions, after.positions, strict=True)]
    else:
        speeds = _means(before.speeds, after.speeds)
    rates = [(b - a) / dt for a, b in zip(before.angles, after.angles, strict=True)]
    yaw_rate = after.yaw_rate
    if yaw_rate is not None and before.yaw_rate is not None:
        yaw_rate = (before.yaw_rate + yaw_rate) / 2.0
    angles = _means(before.angles, after.angles)
    return JointStates(after.time, speeds, angles, rates, None, yaw_rate)


def _means(before: Sequence[float], after: Sequence[float]) -> list[float]:
    return [(a + b) / 2.0 for a, b in zip(before, after, strict=True)]
