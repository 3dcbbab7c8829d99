"""Covariance of the pose from errors that last: wrong wheel radii and wrong steering zeros.

A wrong wheel radius or steering zero causes an error of the twist in the same direction in every
tick.  The errors of the ticks do not average out.  The pose error therefore grows with the travelled
distance, and not with its square root.  Such an error b with the standard deviation 1 causes the
twist error k(t) b, where the sensitivity k(t) depends on the motion
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
the covariance of the pose grows by the difference between the new and the old matrix C.
"""

from __future__ import annotations

import math

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.runtime.se2 import ORIGIN, Cov3, Pose2, Row3, Twist

BLOCK_TIME = 0.25
"""Shortest time (s) over which the sensitivities of the twist count as constant."""

_Upper = tuple[float, float, float, float, float, float]
_NO_COVARIANCE: _Upper = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


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
        self._upper = _NO_COVARIANCE

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
        if 0.0 < elapsed < math.inf and pose != previous:
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
        o11, o12, o13, o22, o23, o33 = self._upper
        d12, d13, d23 = c12 - o12, c13 - o13, c23 - o23
        growth = ((c11 - o11, d12, d13), (d12, c22 - o22, d23), (d13, d23, c33 - o33))
        local = Pose2(pose.x - self._anchor.x, pose.y - self._anchor.y, pose.yaw)
        grown = se2.add(covariance, se2.seen_from(local, growth))
        if not math.isfinite(grown[0][0] + grown[1][1] + grown[2][2]):
            raise NotFiniteError("the joint states are out of all bounds")
        self._sensitivities, self._upper = sensitivities, (c11, c12, c13, c22, c23, c33)
        return grown


def _parameters(estimator: TwistEstimator) -> tuple[object, ...]:
    """Returns the parameters whose errors last."""
    radii = tuple(wheel.radius for wheel in estimator.wheels)
    return estimator.noise.lasting_errors, radii
