"""Wheel odometry: twist and pose from joint states, with covariances and warnings about wheels."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import combinations
from typing import Final, NamedTuple

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import CheckedJointStates, JointStates, NotFiniteError
from thorvaldc.runtime.calculators import BaseCalculator, WheelGeometry
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, ZERO_TWIST, Cov3, Pose2, Row3, Twist

LONGEST_INTERVAL: Final = 0.5
"""Longest interval (s) between two joint states over which the odometry integrates the motion."""
LOW_RANK_CORRELATION: Final = 10.0
"""Correlation time (s) of the velocity errors in directions that no wheel measures."""
_SAME_CAUSE: Final = 10.0
"""Time (s) in which wheels that disagree again have the same cause."""
_TIME_CONSTANT: Final = 2.0
"""Time constant (s) of the share of time in which a wheel is left out or doubted."""
_WARNED_SHARE: Final = 0.5
"""Share of the time from which a warning is raised.

Healthy wheels fail their tests in 1 % of the ticks; a faulty wheel that moves fails in most.
"""
_FORGOTTEN_SHARE: Final = 0.001


class Odometry:
    """Integrates the twist estimates of a calculator to a pose.

    - ``estimate``: estimated mean twist in the interval between the last two joint states.
    - ``pose``: pose of ``base_link`` in the odometry frame.
    - ``covariance``: covariance of the pose, expressed as a small motion in ``base_link``.  The
      covariance of the pose grows while joint states are missing.
    - ``joints``: last joint states, or ``None`` before the first update.
    - ``motion_time``: time (s) for which the robot has moved, for the module ``filter_covariance``.
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
        self.motion_time = 0.0
        self.covariance_at_joints = ZERO_COV
        self._time = -math.inf
        self._lasting_errors = LastingErrors(calculator.estimator)
        self._undecided = _DECIDED
        self._wheel_warnings = WheelWarnings()

    @property
    def warnings(self) -> list[str]:
        """Warnings about wheels that the odometry leaves out or doubts, for an operator."""
        return self._wheel_warnings.texts(self.calculator.geometry.wheels)

    def reset(self, pose: Pose2 = ORIGIN) -> None:
        """Sets the pose of the odometry and resets its covariance to zero."""
        self.pose = pose
        self.covariance = self.covariance_at_joints = ZERO_COV
        self._lasting_errors.restart(pose)
        self._undecided = _DECIDED

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
        undecided = self._undecided
        if estimate.dropped or estimate.suspects or estimate.sliding:
            undecided, growth = undecided.after(pose, estimate.covariance, elapsed, joints.time)
            covariance = se2.combine(covariance, growth)
        if pose != self.pose:
            self.motion_time += elapsed
        self.store(joints, now, estimate, pose, covariance)
        self._undecided = undecided

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


class UndecidedErrors(NamedTuple):
    """Growth of the covariance of a pose while wheels are left out or doubted.

    The same cause is right for as long as it lasts, so that the errors of the ticks are the same in
    the worst case.  Whatever their correlations are, the sum of errors with the covariances Q has
    at most the covariance

        T integral of Ad(pose) Q Ad(pose)' dt

    where T is the time in which the wheels were undecided (inequality of Cauchy and Schwarz).
    Another cause, ``_SAME_CAUSE`` later, has independent errors.

    - ``time``: T (s).
    - ``integral``: the integral above.
    - ``end``: time (s) of the last joint states in T.
    """

    time: float
    integral: Cov3
    end: float

    def after(self, pose: Pose2, q: Cov3, dt: float, end: float) -> tuple[UndecidedErrors, Cov3]:
        """Returns the errors after ``dt`` s more, and the growth of the covariance of ``pose``.

        ``q``: covariance of the twist in this time.
        """
        time, integral, _ = self if end - self.end < _SAME_CAUSE else _DECIDED
        added = se2.seen_from(ORIGIN.relative_to(pose), q)
        growth = se2.combine(ZERO_COV, integral, dt)
        growth = se2.combine(growth, added, (time + dt) * dt)
        undecided = UndecidedErrors(time + dt, se2.combine(integral, added, dt), end)
        return undecided, se2.seen_from(pose, growth)


_DECIDED: Final = UndecidedErrors(0.0, ZERO_COV, -math.inf)


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
        speeds = _rates(start.positions, end.positions, dt)
    else:
        speeds = _means(start.speeds, end.speeds)
    rates = _rates(start.angles, end.angles, dt)
    yaw_rate = end.yaw_rate
    if yaw_rate is not None and start.yaw_rate is not None:
        yaw_rate = (start.yaw_rate + yaw_rate) / 2.0
    angles = _means(start.angles, end.angles)
    return CheckedJointStates(end.time, speeds, angles, rates, None, yaw_rate)


# mypyc compiles a loop over `zip` without arguments by name, and calls `zip` with them.


def _rates(start: Sequence[float], end: Sequence[float], dt: float) -> list[float]:
    return [(b - a) / dt for a, b in zip(start, end)]  # noqa: B905


def _means(start: Sequence[float], end: Sequence[float]) -> list[float]:
    return [(a + b) / 2.0 for a, b in zip(start, end)]  # noqa: B905


class WheelWarnings:
    """Collects over time which wheels the odometry leaves out or doubts.

    A share s of the time with the value x (0 or 1) in a tick of dt s changes by (x - s) dt / (tau +
    dt), where tau is the time constant.
    """

    def __init__(self) -> None:
        self._dropped: dict[int, float] = {}
        self._suspects: dict[int, float] = {}
        self._sliding: dict[int, float] = {}
        self._time = math.inf

    def update(self, estimate: TwistEstimate, time: float) -> None:
        """Adds the estimate of a tick with joint states that were measured at ``time`` (s)."""
        named = estimate.dropped or estimate.suspects or estimate.sliding
        if named or self._dropped or self._suspects or self._sliding:
            elapsed = min(max(time - self._time, 0.0), LONGEST_INTERVAL)
            gain = elapsed / (_TIME_CONSTANT + elapsed)
            _update(self._dropped, estimate.dropped, gain)
            _update(self._suspects, estimate.suspects, gain)
            _update(self._sliding, estimate.sliding, gain)
        self._time = time

    def texts(self, wheels: Sequence[WheelGeometry]) -> list[str]:
        """Returns the present warnings for an operator; ``wheels``: all wheels of the robot."""
        warnings = []
        if dropped := _lasting(self._dropped):
            warnings.append(
                f"odometry: left out {_listed(dropped, wheels)}: the speed or direction disagrees"
                " with the other wheels or with the command; check the encoders"
            )
        suspects = [i for i in _lasting(self._suspects) if i not in dropped]
        sliding = [i for i in _lasting(self._sliding) if i not in dropped]
        others = [i for i in suspects if i not in sliding and wheels[i].encoder]
        if sliding and others:
            are = "turns as commanded" if len(sliding) == 1 else "turn as commanded"
            do = "does not" if len(others) == 1 else "do not"
            warnings.append(
                f"odometry: stuck, or encoders dead? {_listed(sliding, wheels)} {are}, and"
                f" {_listed(others, wheels)} {do}: look whether the robot moves. If it moves, check"
                " the encoders; the covariance covers both cases"
            )
        elif suspects:
            warnings.append(
                f"odometry: the measured speed or direction of {_listed(suspects, wheels)} may be"
                " wrong, or the robot does not move as commanded; the covariance covers both cases"
            )
        elif sliding:
            warnings.append(
                "odometry: the wheels slide, the robot is held or pulled, and its motion is"
                " unknown; look whether it moves"
            )
        return warnings


def _listed(numbers: Sequence[int], wheels: Sequence[WheelGeometry]) -> str:
    return ", ".join(wheels[i].name for i in numbers)


def _update(shares: dict[int, float], wheels: Collection[int], gain: float) -> None:
    for wheel in {*shares, *wheels}:
        share = shares.get(wheel, 0.0)
        shares[wheel] = share + gain * (float(wheel in wheels) - share)
        if shares[wheel] < _FORGOTTEN_SHARE and wheel not in wheels:
            del shares[wheel]


def _lasting(shares: dict[int, float]) -> list[int]:
    return sorted(wheel for wheel, share in shares.items() if share > _WARNED_SHARE)


# -- covariance of the pose from errors that last longer than a tick ----------------------------
#
# Errors that last for the whole drive: a wrong wheel radius or steering zero causes an error of the
# twist in the same direction in every tick.  The errors of the ticks do not average out.  The pose
# error therefore grows with the distance that the robot travels, and not with the square root of
# the distance.  Such an error b with the standard deviation 1 causes the twist error k(t) b, where
# the sensitivity k(t) depends on the motion (``TwistEstimator.lasting_errors``).  Sensitivity of
# the pose error to b, and covariance of the pose error from independent errors b_1, b_2, ...:
#
#     S_b(t) = integral of Ad(pose) k_b dt,   C = sum S_b S_b'
#
# The adjoint Ad(pose) converts a small motion of ``base_link`` to the resulting small motion of the
# odometry frame about its origin.  In this frame, the sensitivities of all motions simply add up.
# This treatment of constant errors that the estimator does not estimate is the consider covariance,
# or Schmidt-Kalman filter (Schmidt, "Application of state-space methods to navigation problems",
# 1966).
#
# Small motions commute, but large ones do not.  Over long drives, yaw errors of 10 deg and more
# occur.  With the yaw part theta and the position part rho of S, the second-order term of the
# Baker-Campbell-Hausdorff formula adds the area between both to the position error:
#
#     q = 1/2 R(90 deg) integral of (theta d rho - rho d theta) = sum over i, j of A_ij b_i b_j
#
# For normally distributed errors, E[q q'] = (tr A)(tr A)' + 2 tr(A A').  The covariance describes
# the logarithm of the relative pose, in which first and second order suffice (Long et al., "The
# banana distribution is Gaussian", 2012).
#
# Errors that last for some seconds (``Noise.correlation``): the twist error e in ``base_link`` has
# the covariance Q of the estimate and the autocorrelation exp(-t / tau).  With the cross-covariance
# D of the pose error and e, and with a = exp(-h / tau), the covariance R grows in a block of h s by
#
#     R <- R + l (D Ad' + Ad D') + 2 tau (h - l) Ad Q Ad',   D <- a D + l Ad Q,   l = tau (1 - a)
#
# The sensitivities and Q change slowly, because the motion of the robot changes slowly.  They are
# therefore computed once per block of several ticks, with the mean twist in the block.  At the end
# of a block, the covariance of the pose grows by the change of C + E[q q'] + R.

BLOCK_TIME: Final = 0.4
"""Shortest time (s) over which the sensitivities of the twist count as constant."""
_BLOCKS_PER_AREA: Final = 5
"""Number of blocks after which the areas A change.  The areas change more slowly than S."""


class LastingErrors:
    """Share of one robot's pose covariance that is caused by errors that last.

    A wheel with the rolling speed v and the relative radius error r changes its rolling measurement
    by r v.  An error e of its direction changes its side slip by e v.  The estimate xi = P sum(H' W
    m) is linear in the measurements, so the errors of the twist are P L' w_L r v and P T' w_T e v.
    With k_b, the error of the twist per standard deviation of the error b, the odometry integrates

        S_b = integral of Ad(pose) k_b dt,     C = sum of S_b S_b',

    in the odometry frame, and adds C to the covariance (consider covariance, Schmidt 1966).  After
    a drive of 77 s with radii that are 1 % wrong, the yaw error is 10 to 20 deg, so that small
    motions no longer commute.  With the yaw part theta and the position part rho of S, the
    Baker-Campbell-Hausdorff formula adds 1/2 integral of (theta d rho - rho d theta), rotated by
    90 deg, to the error; the covariance of this quadratic form is added too.

    The twist error e that lasts for some seconds has the covariance Q of the last estimate in
    which no wheel was doubted, and the autocorrelation exp(-t / tau).  The cross-covariance D of
    the pose error and e is carried along, which gives the exact covariance for drives of any length
    and in curves.

    ``start_time``: time (s) of the joint states at the start of the present block.
    """

    def __init__(self, estimator: TwistEstimator) -> None:
        self._estimator = estimator
        self.restart(ORIGIN)

    def restart(self, pose: Pose2) -> None:
        """Discards all sensitivities, because the pose is known to be ``pose``."""
        self._anchor = pose
        self._pose = pose
        self.start_time = -math.inf
        self._forget()

    def _forget(self) -> None:
        self._share = ZERO_COV
        self._sensitivities: list[Row3] = []  # S of each error
        self._blocks = 0
        self._areas: list[tuple[float, float]] = []  # A, as in _with_areas
        self._areas_end: list[Row3] = []  # S at the last change of A
        self._second_order = ZERO_COV  # E[q q']
        self._twist_covariance = ZERO_COV  # Q
        self._cross: Cov3 = ZERO_COV  # D
        self._correlated = ZERO_COV  # R

    def is_due(self, time: float) -> bool:
        """Returns ``True`` if a block ends with the joint states of ``time`` (s)."""
        return not 0.0 <= time - self.start_time < BLOCK_TIME

    def end_block(
        self,
        estimator: TwistEstimator,
        joints: JointStates,
        estimate: TwistEstimate,
        pose: Pose2,
        covariance: Cov3,
    ) -> Cov3:
        """Ends a block, and returns the covariance of the pose with the growth in the block.

        - ``joints``, ``estimate``: last joint states of the block, and the estimate from them.
        - ``pose``, ``covariance``: pose at the end of the block, and its covariance without the
          growth.

        Raises ``NotFiniteError`` if the result is not finite.
        """
        previous, elapsed = self._pose, joints.time - self.start_time
        if estimator is not self._estimator:
            if _parameters(estimator) != _parameters(self._estimator):
                # The errors of the new parameters are independent of the errors of the old ones.
                self._forget()
            self._estimator = estimator
        if not 0.0 < elapsed < math.inf:
            # The first block starts, or the time of the joint states has decreased.
            self.start_time = joints.time
            return covariance
        if pose != previous:
            try:
                covariance = self._grown(covariance, joints, estimate, pose, elapsed)
            except (ZeroDivisionError, OverflowError):
                raise NotFiniteError("the joint states are out of all bounds") from None
        self._pose, self.start_time = pose, joints.time
        return covariance

    def _grown(
        self,
        covariance: Cov3,
        joints: JointStates,
        estimate: TwistEstimate,
        pose: Pose2,
        elapsed: float,
    ) -> Cov3:
        previous = self._pose
        yaw = (previous.yaw + pose.yaw) / 2.0
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = (pose.x - previous.x) / elapsed, (pose.y - previous.y) / elapsed
        twist = Twist(c * dx + s * dy, c * dy - s * dx, (pose.yaw - previous.yaw) / elapsed)
        estimator = self._estimator
        errors = estimator.lasting_errors(joints, estimate, twist)
        # The odometry itself treats errors in directions that no wheel measures.
        tau = estimator.noise.correlation if estimate.rank == 3 else 0.0
        if not (estimate.dropped or estimate.suspects or estimate.sliding):
            self._twist_covariance = estimate.covariance
        if not errors and not tau:
            return covariance
        # Position in the middle of the block, relative to the start of the drive.
        x = (previous.x + pose.x) / 2.0 - self._anchor.x
        y = (previous.y + pose.y) / 2.0 - self._anchor.y
        c, s, x, y = c * elapsed, s * elapsed, x * elapsed, y * elapsed
        sensitivities: list[Row3] = []
        c11 = c12 = c13 = c22 = c23 = c33 = 0.0
        for (sx, sy, sw), (ex, ey, ew) in zip(
            self._sensitivities or [(0.0, 0.0, 0.0)] * len(errors), errors, strict=True
        ):
            sx += c * ex - s * ey + y * ew
            sy += s * ex + c * ey - x * ew
            sw += elapsed * ew
            sensitivities.append((sx, sy, sw))
            c11 += sx * sx
            c12 += sx * sy
            c13 += sx * sw
            c22 += sy * sy
            c23 += sy * sw
            c33 += sw * sw
        total = ((c11, c12, c13), (c12, c22, c23), (c13, c23, c33))
        areas, areas_end, second_order = self._areas, self._areas_end, self._second_order
        blocks = self._blocks + 1
        if blocks % _BLOCKS_PER_AREA == 0:
            areas, second_order = _with_areas(areas, areas_end, sensitivities)
            areas_end = sensitivities
        total = se2.combine(total, second_order)
        cross, correlated = self._cross, self._correlated
        if tau:
            adjoint = ((c, -s, y), (s, c, -x), (0.0, 0.0, elapsed))
            cross, growth = _correlated(cross, adjoint, self._twist_covariance, elapsed / tau)
            correlated = se2.combine(correlated, growth)
            total = se2.combine(total, correlated)
        local = Pose2(pose.x - self._anchor.x, pose.y - self._anchor.y, pose.yaw)
        share = se2.seen_from(local, total)
        previous_share = se2.seen_from(pose.relative_to(previous), self._share)
        grown = se2.combine(se2.combine(covariance, previous_share, -1.0), share)
        if not math.isfinite(grown[0][0] + grown[1][1] + grown[2][2]):
            raise NotFiniteError("the joint states are out of all bounds")
        self._sensitivities, self._share = sensitivities, share
        self._areas, self._areas_end, self._second_order = areas, areas_end, second_order
        self._blocks = blocks
        self._cross, self._correlated = cross, correlated
        return grown


def _with_areas(
    areas: Sequence[tuple[float, float]], start: Sequence[Row3], end: Sequence[Row3]
) -> tuple[list[tuple[float, float]], Cov3]:
    """Returns the areas A after a change of the sensitivities, and the covariance E[q q'].

    - ``areas``: x and y part of A_ij before the change: first of i = j, then of i < j.  Empty at
      the start of a drive.
    - ``start``, ``end``: sensitivities before and after the change.

    A change from S to T adds 1/4 (S_i^w T_j + S_j^w T_i - T_i^w S_j - T_j^w S_i) to A_ij.
    """
    n = len(end)
    areas = areas or [(0.0, 0.0)] * (n * (n + 1) // 2)
    changes = list(zip(start or [(0.0, 0.0, 0.0)] * n, end, strict=True))
    new: list[tuple[float, float]] = []
    trace_x = trace_y = xx = xy = yy = 0.0
    for ((ax, ay, aw), (bx, by, bw)), (x, y) in zip(changes, areas[:n], strict=True):
        x += 0.5 * (aw * bx - bw * ax)
        y += 0.5 * (aw * by - bw * ay)
        new.append((x, y))
        trace_x += x
        trace_y += y
        xx += 0.5 * x * x
        xy += 0.5 * x * y
        yy += 0.5 * y * y
    for (((ax, ay, aw), (bx, by, bw)), ((cx, cy, cw), (dx, dy, dw))), (x, y) in zip(
        combinations(changes, 2), areas[n:], strict=True
    ):
        x += 0.25 * (aw * dx + cw * bx - bw * cx - dw * ax)
        y += 0.25 * (aw * dy + cw * by - bw * cy - dw * ay)
        new.append((x, y))
        xx += x * x
        xy += x * y
        yy += y * y
    # A is symmetric, so that tr(A A') is twice the sums.  The rotation by 90 deg exchanges x and y.
    q11, q22 = trace_y * trace_y + 4.0 * yy, trace_x * trace_x + 4.0 * xx
    q12 = -trace_x * trace_y - 4.0 * xy
    return new, ((q11, q12, 0.0), (q12, q22, 0.0), (0.0, 0.0, 0.0))


def _correlated(cross: Cov3, adjoint: Cov3, q: Cov3, ratio: float) -> tuple[Cov3, Cov3]:
    """Returns the new cross-covariance D, and the growth of the covariance R in a block.

    - ``cross``: D at the start of the block.
    - ``adjoint``: h Ad, for a block of h s.
    - ``q``: covariance of the twist.
    - ``ratio``: h / tau.
    """
    decay = math.exp(-ratio)
    mean = (1.0 - decay) / ratio  # l / h
    square = (1.0 - mean) / ratio  # tau (h - l) / h^2
    new: list[Row3] = []
    factors: list[Row3] = []
    (q11, q12, q13), (_, q22, q23), (_, _, q33) = q
    for (a1, a2, a3), (d1, d2, d3) in zip(adjoint, cross, strict=True):
        m1 = a1 * q11 + a2 * q12 + a3 * q13
        m2 = a1 * q12 + a2 * q22 + a3 * q23
        m3 = a1 * q13 + a2 * q23 + a3 * q33
        new.append((decay * d1 + mean * m1, decay * d2 + mean * m2, decay * d3 + mean * m3))
        factors.append((mean * d1 + square * m1, mean * d2 + square * m2, mean * d3 + square * m3))
    (f11, f12, f13), (f21, f22, f23), (f31, f32, f33) = factors
    (a11, a12, a13), (a21, a22, a23), (_, _, a33) = adjoint
    r12 = f11 * a21 + f12 * a22 + f13 * a23 + f21 * a11 + f22 * a12 + f23 * a13
    r13 = f13 * a33 + f31 * a11 + f32 * a12 + f33 * a13
    r23 = f23 * a33 + f31 * a21 + f32 * a22 + f33 * a23
    growth = (
        (2.0 * (f11 * a11 + f12 * a12 + f13 * a13), r12, r13),
        (r12, 2.0 * (f21 * a21 + f22 * a22 + f23 * a23), r23),
        (r13, r23, 2.0 * f33 * a33),
    )
    return (new[0], new[1], new[2]), growth


def _parameters(estimator: TwistEstimator) -> tuple[object, ...]:
    """Returns the parameters whose errors last."""
    radii = tuple(wheel.radius for wheel in estimator.wheels)
    return estimator.noise.lasting_errors, radii
