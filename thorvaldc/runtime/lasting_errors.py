"""Covariance of the pose from errors that last: wrong wheel radii and wrong steering zeros.

A wrong wheel radius or steering zero causes an error of the twist in the same direction in every
tick.  The errors of the ticks do not average out.  The pose error therefore grows with the distance
that the robot travels, and not with the square root of the distance.  Such an error b with the
standard deviation 1 causes the twist error k(t) b, where the sensitivity k(t) depends on the motion
(``TwistEstimator.lasting_errors``).  Sensitivity of the pose error to b, and covariance of the pose
error from independent errors b_1, b_2, ...:

    S_b(t) = integral of Ad(pose) k_b dt,   C = sum S_b S_b'

The adjoint Ad(pose) converts a small motion of ``base_link`` to the resulting small motion of the
odometry frame about its origin.  In this frame, the sensitivities of all motions simply add up.
This treatment of constant errors that the estimator does not estimate is the consider covariance,
or Schmidt-Kalman filter (Schmidt, "Application of state-space methods to navigation problems",
1966).

The sensitivities change slowly, because the motion of the robot changes slowly.  They are therefore
computed once per block of several ticks, with the mean twist in the block.  At the end of a block,
the covariance of the pose grows by the difference between the new and the old matrix C.  Over long
drives, yaw errors of many degrees occur, and the matrix C also contains their second-order effect.
"""

from __future__ import annotations

import math

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, Cov3, Pose2, Row3, Twist

BLOCK_TIME = 0.4
"""Shortest time (s) over which the sensitivities of the twist count as constant."""


class LastingErrors:
    """Sensitivities of one robot's pose to the errors of wheel radii and steering zeros.

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
        self._sensitivities: list[Row3] = []
        self._share = ZERO_COV

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
        errors = self._estimator.lasting_errors(joints, estimate, twist)
        if not errors:
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
        local = Pose2(pose.x - self._anchor.x, pose.y - self._anchor.y, pose.yaw)
        first_order = se2.seen_from(local, ((c11, c12, c13), (c12, c22, c23), (c13, c23, c33)))
        share = _with_second_order(first_order)
        previous_share = se2.seen_from(pose.relative_to(previous), self._share)
        grown = se2.combine(se2.combine(covariance, previous_share, -1.0), share)
        if not math.isfinite(grown[0][0] + grown[1][1] + grown[2][2]):
            raise NotFiniteError("the joint states are out of all bounds")
        self._sensitivities, self._share = sensitivities, share
        return grown


def _with_second_order(p: Cov3) -> Cov3:
    """Adds the covariance of the second-order pose error to the covariance ``p``.

    A yaw error w rotates a position error v and changes it by w (-v_y, v_x).  Such errors matter if
    the yaw error exceeds some degrees.  For normally distributed errors, E[w^2 v v'] = E[w^2]
    E[v v'] + 2 E[w v] E[w v'].
    """
    (p11, p12, p13), (_, p22, p23), (_, _, p33) = p
    k12 = p12 - (p33 * p12 + 2.0 * p13 * p23)
    return (
        (p11 + p33 * p22 + 2.0 * p23 * p23, k12, p13),
        (k12, p22 + p33 * p11 + 2.0 * p13 * p13, p23),
        (p13, p23, p33),
    )


def _parameters(estimator: TwistEstimator) -> tuple[object, ...]:
    """Returns the parameters whose errors last."""
    radii = tuple(wheel.radius for wheel in estimator.wheels)
    return estimator.noise.lasting_errors, radii
