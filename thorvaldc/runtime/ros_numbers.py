"""The numbers of ROS messages: poses, twists and covariances of a planar robot."""

from __future__ import annotations

import math

from thorvaldc.model import Robot
from thorvaldc.model.spatial import quat_from_rpy
from thorvaldc.runtime.se2 import ZERO_COV, Cov3, Pose2, Twist

Posture = tuple[float, float, float]
"""Height (m), roll and pitch (rad)."""
LEVEL: Posture = (0.0, 0.0, 0.0)
_UNKNOWN_COVARIANCE = (0.0,) * 36


def pose_numbers(pose: Pose2, posture: Posture = LEVEL) -> tuple[float, ...]:
    """Returns the numbers of a ROS pose: x, y, z (m) and a quaternion xyzw."""
    z, roll, pitch = posture
    w, i, j, k = quat_from_rpy(roll, pitch, pose.yaw)
    return pose.x, pose.y, z, i, j, k, w


def twist_numbers(twist: Twist) -> tuple[float, ...]:
    """Returns the numbers of a ROS twist: linear velocity x, y, z and angular velocity x, y, z."""
    return twist.vx, twist.vy, 0.0, 0.0, 0.0, twist.wz


def covariance_numbers(planar: Cov3, yaw: float = 0.0) -> tuple[float, ...]:
    """Returns the numbers of a ROS covariance, a 6x6 matrix of (x, y, z, roll, pitch, yaw) by rows.

    ``planar`` is the covariance C of (x, y, yaw).  The frame of ``planar`` is rotated by the angle
    ``yaw`` (rad) relative to the frame of the message.  The covariance in the frame of the message
    is R C R^T with the rotation matrix R.  By ROS convention, the value zero means an unknown
    covariance.
    """
    if planar is ZERO_COV:
        return _UNKNOWN_COVARIANCE
    (xx, xy, xa), (_, yy, ya), (_, _, aa) = planar
    if yaw:
        c, s = math.cos(yaw), math.sin(yaw)
        xx, xy, yy = (
            c * c * xx - 2.0 * c * s * xy + s * s * yy,
            c * s * (xx - yy) + (c * c - s * s) * xy,
            s * s * xx + 2.0 * c * s * xy + c * c * yy,
        )
        xa, ya = c * xa - s * ya, s * xa + c * ya
    x_and_y_rows = (xx, xy, 0.0, 0.0, 0.0, xa, xy, yy, 0.0, 0.0, 0.0, ya)
    return (*x_and_y_rows, *_UNKNOWN_COVARIANCE[:18], xa, ya, 0.0, 0.0, 0.0, aa)


def recorded_joints(robot: Robot) -> tuple[dict[str, int], dict[str, int]]:
    """Returns the drive joints and the steering joints of a robot.

    The joints are mappings from the joint name to the index of the first wheel on the joint.  Two
    wheels may share a steering joint or a drive joint.
    """
    drives: dict[str, int] = {}
    steering: dict[str, int] = {}
    for i, wheel in enumerate(robot.wheels):
        if wheel.driven:
            drives.setdefault(wheel.spin_joint, i)
        if wheel.steering_joint is not None:
            steering.setdefault(wheel.steering_joint, i)
    return drives, steering
