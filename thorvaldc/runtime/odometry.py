"""Wheel odometry: twist and pose from joint states, with covariances and warnings about wheels."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import CheckedJointStates, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, TwistEstimate
from thorvaldc.runtime.lasting_errors import LastingErrors
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, ZERO_TWIST, Cov3, Pose2

LONGEST_INTERVAL = 0.5
"""Longest interval (s) between two joint states over which the odometry integrates the motion."""
LOW_RANK_CORRELATION = 10.0
"""Correlation time (s) of the velocity errors in directions that no wheel measures."""
_TIME_CONSTANT = 2.0
"""Time constant (s) of the share of time in which a wheel is left out or doubted."""
_WARNED_SHARE = 0.5
"""Share of the time from which a warning is raised.

Healthy wheels fail their tests in 1 % of the ticks; a faulty wheel that moves fails in most.
"""
_FORGOTTEN_SHARE = 0.001


class Odometry:
    """Integrates the twist estimates of a calculator to a pose.

    - ``estimate``: estimated mean twist in the interval between the last two joint states.
    - ``pose``: pose of ``base_link`` in the odometry frame.
    - ``covariance``: covariance of the pose, expressed as a small motion in ``base_link``.  The
      covariance of the pose grows while joint states are missing.
    - ``joints``: last joint states, or ``None`` before the first update.
    - ``covariance_at_joints``: covariance of the pose at the time of ``joints``.
    - ``calculator``: base calculator, which can be replaced between two updates without a change of
      the pose.
    - ``top_speeds``: largest possible speed (m/s) and yaw rate (rad/s) while joint states are
      missing.
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
        self._lasting_errors = LastingErrors(calculator.estimator)
        self._wheel_warnings = WheelWarnings()

    @property
    def warnings(self) -> list[str]:
        """Warnings about wheels that the odometry leaves out or doubts, for an operator."""
        return self._wheel_warnings.texts([w.name for w in self.calculator.geometry.wheels])

    def reset(self, pose: Pose2 = ORIGIN) -> None:
        """Sets the pose of the odometry and resets its covariance to zero."""
        self.pose = pose
        self.covariance = self.covariance_at_joints = ZERO_COV
        self._lasting_errors.restart(pose)

    def update(self, joints: JointStates, now: float) -> None:
        """Updates the pose with the joint states that were read at ``now`` (s, monotonic).

        Between two joint states the robot is assumed to move with the mean twist.  The motion of
        the robot is unknown if the interval is longer than ``LONGEST_INTERVAL`` or if the time of
        the joint states decreases.  If the motion of the robot is unknown, the pose does not
        change, and the covariance of the pose grows by the largest possible motion.  Joint states
        with the same time as the previous joint states count as missing.

        Raises ``ValueError`` if the joint states are unusable, and ``NotFiniteError`` if a joint
        state is NaN. The odometry is unchanged after an error.
        """
        previous = self.joints
        if previous is None:
            estimate = self.calculator.odometry(joints)
            self.store(joints, now, estimate, self.pose, self.covariance_at_joints)
            return
        if joints is previous and now == self._time:
            return  # an OdometryBatch has already integrated these joint states
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
        estimate = self.calculator.odometry(mean_states(previous, joints, elapsed))
        correlation = LOW_RANK_CORRELATION if estimate.rank < 3 else 0.0
        motion, covariance = se2.integrate(
            self.covariance_at_joints, estimate.twist, estimate.covariance, elapsed, correlation
        )
        pose = self.pose.moved(motion)
        self.store(joints, now, estimate, pose, covariance)

    def mark_missing(self, now: float) -> None:
        """Increases the covariance of the pose because the joint states at ``now`` are missing."""
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
        """Stores the pose and the estimate for the joint states that were read at ``now`` (s).

        The caller has checked the joint states with ``TwistEstimator.check``.  ``covariance`` is
        the covariance of the pose without the growth by lasting errors since the
        last update.  Raises ``NotFiniteError`` if this growth is not finite.
        """
        lasting = self._lasting_errors
        if lasting.is_due(joints.time):
            covariance = lasting.end_block(
                self.calculator.estimator, joints, estimate, pose, covariance
            )
        self._wheel_warnings.update(estimate, joints.time)
        self.joints = self.calculator.checked_states = joints
        self.estimate = estimate
        self.pose = pose
        self.covariance = self.covariance_at_joints = covariance
        self._time = now

    def _unknown_motion(self, time: float) -> Cov3:
        """Returns the covariance of the pose after ``time`` s of unknown motion.

        The unknown motion is limited by the robot's top speeds.
        """
        way = (self.top_speeds[0] * time) ** 2
        turn = (self.top_speeds[1] * time) ** 2
        (a, b, c), (_, d, e), (_, _, f) = self.covariance_at_joints
        return ((a + way, b, c), (b, d + way, e), (c, e, f + turn))


def mean_states(start: JointStates, end: JointStates, dt: float) -> CheckedJointStates:
    """Returns the mean of two checked joint states at the start and the end of an interval.

    If the base measures positions, the wheel speeds are computed from the differences of the
    positions.

    The steering angles at the start and the end of the interval are averaged.  Each measured
    steering angle affects two intervals, with half of its error in each interval.  Over many
    intervals, the sum of the mean angles has the same error as with independent errors in each
    interval.  The covariance of the pose therefore assumes independent errors in each interval.
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
    return CheckedJointStates(end.time, speeds, angles, rates, None, yaw_rate)


def _means(start: Sequence[float], end: Sequence[float]) -> list[float]:
    return [(a + b) / 2.0 for a, b in zip(start, end, strict=True)]


class WheelWarnings:
    """Collects over time which wheels the odometry leaves out or doubts.

    A share s of the time with the value x (0 or 1) in a tick of dt s changes by (x - s) dt / (tau +
    dt), where tau is the time constant.
    """

    def __init__(self) -> None:
        self._dropped: dict[int, float] = {}
        self._suspects: dict[int, float] = {}
        self._time = math.inf

    def update(self, estimate: TwistEstimate, time: float) -> None:
        """Adds the estimate of a tick with joint states that were measured at ``time`` (s)."""
        if estimate.dropped or estimate.suspects or self._dropped or self._suspects:
            elapsed = max(time - self._time, 0.0)
            gain = elapsed / (_TIME_CONSTANT + elapsed)
            _update(self._dropped, estimate.dropped, gain)
            _update(self._suspects, estimate.suspects, gain)
        self._time = time

    def texts(self, names: Sequence[str]) -> list[str]:
        """Returns the present warnings for an operator; ``names``: names of all wheels."""
        warnings = []
        if dropped := _lasting(self._dropped):
            wheels = ", ".join(names[i] for i in dropped)
            warnings.append(
                f"odometry: left out {wheels}: the speed or direction disagrees with the other"
                " wheels or with the command; check the encoders"
            )
        if suspects := [i for i in _lasting(self._suspects) if i not in dropped]:
            wheels = ", ".join(names[i] for i in suspects)
            warnings.append(
                f"odometry: the encoders of {wheels} may be wrong, or the wheels do not follow"
                " their commands; the covariance covers both cases"
            )
        return warnings


def _update(shares: dict[int, float], wheels: Collection[int], gain: float) -> None:
    for wheel in {*shares, *wheels}:
        share = shares.get(wheel, 0.0)
        shares[wheel] = share + gain * (float(wheel in wheels) - share)
        if shares[wheel] < _FORGOTTEN_SHARE and wheel not in wheels:
            del shares[wheel]


def _lasting(shares: dict[int, float]) -> list[int]:
    return sorted(wheel for wheel, share in shares.items() if share > _WARNED_SHARE)
