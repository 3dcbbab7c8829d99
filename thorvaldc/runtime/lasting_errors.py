"""Covariance of the pose from errors that last longer than a tick.

Errors that last for the whole drive: a wrong wheel radius or steering zero causes an error of the
twist in the same direction in every tick.  The errors of the ticks do not average out.  The pose
error therefore grows with the distance that the robot travels, and not with the square root of the
distance.  Such an error b with the standard deviation 1 causes the twist error k(t) b, where the
sensitivity k(t) depends on the motion (``TwistEstimator.lasting_errors``).  Sensitivity of the pose
error to b, and covariance of the pose error from independent errors b_1, b_2, ...:

    S_b(t) = integral of Ad(pose) k_b dt,   C = sum S_b S_b'

The adjoint Ad(pose) converts a small motion of ``base_link`` to the resulting small motion of the
odometry frame about its origin.  In this frame, the sensitivities of all motions simply add up.
This treatment of constant errors that the estimator does not estimate is the consider covariance,
or Schmidt-Kalman filter (Schmidt, "Application of state-space methods to navigation problems",
1966).

Small motions commute, but large ones do not.  Over long drives, yaw errors of 10 deg and more
occur.  With the yaw part theta and the position part rho of S, the second-order term of the
Baker-Campbell-Hausdorff formula adds the area between both to the position error:

    q = 1/2 R(90 deg) integral of (theta d rho - rho d theta) = sum over i, j of A_ij b_i b_j

For normally distributed errors, E[q q'] = (tr A)(tr A)' + 2 tr(A A').  The covariance describes the
logarithm of the relative pose, in which first and second order suffice (Long et al., "The banana
distribution is Gaussian", 2012).

Errors that last for some seconds (``Noise.correlation``): the twist error e in ``base_link`` has
the covariance Q of the estimate and the autocorrelation exp(-t / tau).  With the cross-covariance D
of the pose error and e, and with a = exp(-h / tau), the covariance R grows in a block of h s by

    R <- R + l (D Ad' + Ad D') + 2 tau (h - l) Ad Q Ad',   D <- a D + l Ad Q,   l = tau (1 - a)

The sensitivities and Q change slowly, because the motion of the robot changes slowly.  They are
therefore computed once per block of several ticks, with the mean twist in the block.  At the end of
a block, the covariance of the pose grows by the change of C + E[q q'] + R.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, Cov3, Pose2, Row3, Twist

BLOCK_TIME = 0.4
"""Shortest time (s) over which the sensitivities of the twist count as constant."""
_BLOCKS_PER_AREA = 5
"""Number of blocks after which the areas A change.  The areas change more slowly than S."""


class LastingErrors:
    """Share of one robot's pose covariance that is caused by errors that last.

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
            cross, growth = _correlated(cross, adjoint, estimate.covariance, elapsed / tau)
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
