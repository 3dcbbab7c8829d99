"""Messages of ROS 2 from what a simulation knows, by rosbags; times in ns, all else in SI."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from thorvaldc.model.spatial import quat_from_rpy
from thorvaldc.runtime.se2 import ZERO_COV, Cov3, Pose2, Twist

_PLANAR = (0, 1, 5)
"""Rows of x, y and yaw in the 6x6 covariances of ROS."""
_LEVEL = (0.0, 0.0, 0.0)


class RosMessages:
    """Makes messages and their bytes.  Needs rosbags."""

    def __init__(self) -> None:
        import numpy
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_JAZZY)
        types: Any = self.store.types
        self._array = numpy.array
        self._none = numpy.array([], dtype=numpy.float64)
        self._unknown = numpy.zeros(36)
        self._time = types["builtin_interfaces/msg/Time"]
        self._header = types["std_msgs/msg/Header"]
        self._vector = types["geometry_msgs/msg/Vector3"]
        self._point = types["geometry_msgs/msg/Point"]
        self._quaternion = types["geometry_msgs/msg/Quaternion"]
        self._pose = types["geometry_msgs/msg/Pose"]
        self._twist = types["geometry_msgs/msg/Twist"]
        self._pose_known = types["geometry_msgs/msg/PoseWithCovariance"]
        self._twist_known = types["geometry_msgs/msg/TwistWithCovariance"]
        self._transform = types["geometry_msgs/msg/Transform"]
        self._transform_stamped = types["geometry_msgs/msg/TransformStamped"]
        self._twist_stamped = types["geometry_msgs/msg/TwistStamped"]
        self._odometry = types["nav_msgs/msg/Odometry"]
        self._joint_state = types["sensor_msgs/msg/JointState"]
        self._tf = types["tf2_msgs/msg/TFMessage"]

    def bytes(self, message: Any, kind: str) -> bytes:
        """The message of that type as it is on the wire (CDR)."""
        return bytes(self.store.serialize_cdr(message, kind))

    def latched(self) -> Any:
        """The quality of service of ``/tf_static``: who comes later gets it too."""
        from rosbags.interfaces import (
            Qos,
            QosDurability,
            QosHistory,
            QosLiveliness,
            QosReliability,
            QosTime,
        )

        forever = QosTime(2147483647, 4294967295)
        return Qos(
            QosHistory.KEEP_LAST,
            1,
            QosReliability.RELIABLE,
            QosDurability.TRANSIENT_LOCAL,
            forever,
            forever,
            QosLiveliness.AUTOMATIC,
            forever,
            False,
        )

    def odometry(
        self,
        time: int,
        frame: str,
        child: str,
        pose: Pose2,
        twist: Twist,
        posture: tuple[float, float, float] = _LEVEL,
        *,
        pose_covariance: Cov3 = ZERO_COV,
        twist_covariance: Cov3 = ZERO_COV,
    ) -> Any:
        """An Odometry; covariances are in ``child``, and that of the pose is turned to ``frame``.

        ``posture`` is height, roll and pitch.
        """
        x, y, z, orientation = self._place(pose, posture)
        return self._odometry(
            self._stamp(time, frame),
            child,
            self._pose_known(
                self._pose(self._point(x, y, z), orientation),
                self._covariance(_turned(pose_covariance, pose.yaw)),
            ),
            self._twist_known(self._plain(twist), self._covariance(twist_covariance)),
        )

    def transform(
        self,
        time: int,
        frame: str,
        child: str,
        pose: Pose2,
        posture: tuple[float, float, float] = _LEVEL,
    ) -> Any:
        """A TransformStamped."""
        x, y, z, orientation = self._place(pose, posture)
        moved = self._transform(self._vector(x, y, z), orientation)
        return self._transform_stamped(self._stamp(time, frame), child, moved)

    def tf(self, transforms: Sequence[Any]) -> Any:
        """A TFMessage."""
        return self._tf(list(transforms))

    def twist(self, time: int, frame: str, twist: Twist) -> Any:
        """A TwistStamped."""
        return self._twist_stamped(self._stamp(time, frame), self._plain(twist))

    def joints(
        self, time: int, names: Sequence[str], positions: Sequence[float], speeds: Sequence[float]
    ) -> Any:
        """A JointState."""
        array = self._array
        header = self._stamp(time, "")
        return self._joint_state(header, list(names), array(positions), array(speeds), self._none)

    def _stamp(self, time: int, frame: str) -> Any:
        seconds, rest = divmod(time, 1_000_000_000)
        return self._header(self._time(seconds, rest), frame)

    def _plain(self, twist: Twist) -> Any:
        vector = self._vector
        return self._twist(vector(twist.vx, twist.vy, 0.0), vector(0.0, 0.0, twist.wz))

    def _place(
        self, pose: Pose2, posture: tuple[float, float, float]
    ) -> tuple[float, float, float, Any]:
        z, roll, pitch = posture
        w, i, j, k = quat_from_rpy(roll, pitch, pose.yaw)
        return pose.x, pose.y, z, self._quaternion(i, j, k, w)

    def _covariance(self, planar: Cov3) -> Any:
        if planar is ZERO_COV:
            return self._unknown
        full = [0.0] * 36
        for row, values in zip(_PLANAR, planar, strict=True):
            for column, value in zip(_PLANAR, values, strict=True):
                full[6 * row + column] = value
        return self._array(full)


def _turned(covariance: Cov3, yaw: float) -> Cov3:
    """The covariance in a frame in which this one has the heading ``yaw``."""
    if covariance is ZERO_COV:
        return covariance
    c, s = math.cos(yaw), math.sin(yaw)
    (xx, xy, xa), (_, yy, ya), (_, _, aa) = covariance
    cross = c * s * (xx - yy) + (c * c - s * s) * xy
    along = c * xa - s * ya
    aside = s * xa + c * ya
    return (
        (c * c * xx - 2.0 * c * s * xy + s * s * yy, cross, along),
        (cross, s * s * xx + 2.0 * c * s * xy + c * c * yy, aside),
        (along, aside, aa),
    )
