"""Messages of ROS 2 from what a simulation knows; times in ns, all else in SI.

rosbags lays a message out once, with marks in place of its numbers; from then on numbers are
written where the marks were.  That takes a third of the time of making it anew.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from itertools import count
from typing import Any

from thorvaldc.model.spatial import quat_from_rpy
from thorvaldc.runtime.se2 import ZERO_COV, Cov3, Pose2, Twist

Posture = tuple[float, float, float]
"""Height (m), roll and pitch (rad)."""
LEVEL: Posture = (0.0, 0.0, 0.0)
_SECOND = 1_000_000_000
_UNKNOWN = (0.0,) * 36
_FIRST_MARK = 0x51A5C0DE
"""Times of marks count from here on, in s; any that no text of a message is likely to hold."""


class Form:
    """A message of which all but times and numbers (float64) stays the same.

    ``message`` has marks of ``_Marks`` in their places.
    """

    def __init__(self, data: bytes, times: int, numbers: int) -> None:
        self._data = bytearray(data)
        marks = _Marks()
        stamp, number = struct.Struct("<iI"), struct.Struct("<d")
        self._stamps = [_place(data, stamp.pack(*marks.time())) for _ in range(times)]
        places = [_place(data, number.pack(marks.number())) for _ in range(numbers)]
        # Numbers side by side are written at once: (place, how, first, end).
        self._runs: list[tuple[int, struct.Struct, int, int]] = []
        first = 0
        for end in range(1, numbers + 1):
            if end == numbers or places[end] != places[end - 1] + 8:
                self._runs.append((places[first], struct.Struct(f"<{end - first}d"), first, end))
                first = end
        self._stamp = stamp

    def bytes(self, time: int, numbers: Sequence[float]) -> bytes:
        """The message at ``time`` with these numbers, as it is on the wire (CDR)."""
        data = self._data
        for place in self._stamps:
            self._stamp.pack_into(data, place, *divmod(time, _SECOND))
        for place, how, first, end in self._runs:
            how.pack_into(data, place, *numbers[first:end])
        return bytes(data)


def _place(data: bytes, mark: bytes) -> int:
    if data.count(mark) != 1:
        raise ValueError("a mark is not in the message once")
    return data.index(mark)


class _Marks:
    """Times and numbers that are known again, the same in every series."""

    def __init__(self) -> None:
        self._count = count(1)

    def time(self) -> tuple[int, int]:
        number = next(self._count)
        return _FIRST_MARK + number, _SECOND - number

    def number(self) -> float:
        return 1.2345678e-270 * next(self._count)


class RosMessages:
    """Forms of messages.  Needs rosbags."""

    def __init__(self) -> None:
        import numpy
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._types: Any = self.store.types
        self._array = numpy.array
        self._definitions: dict[str, tuple[str, str]] = {}

    def definition(self, kind: str) -> tuple[str, str]:
        """The text that defines a type, and its hash (REP 2016)."""
        if kind not in self._definitions:
            text, _ = self.store.generate_msgdef(kind, ros_version=2)
            self._definitions[kind] = (str(text), self.store.hash_rihs01(kind))
        return self._definitions[kind]

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

    def odometry(self, frame: str, child: str) -> Form:
        """An Odometry: ``place``, ``covariance``, ``velocity``, ``covariance``."""
        marks = _Marks()
        header = self._header(marks, frame)
        pose = self._make("geometry_msgs/msg/Pose", *self._pose(marks, "Point"))
        known = self._make("geometry_msgs/msg/PoseWithCovariance", pose, self._covariance(marks))
        twist = self._twist(marks)
        moving = self._make("geometry_msgs/msg/TwistWithCovariance", twist, self._covariance(marks))
        kind = "nav_msgs/msg/Odometry"
        return self._form(kind, self._make(kind, header, child, known, moving), 1, 85)

    def transforms(self, frames: Sequence[tuple[str, str]]) -> Form:
        """A TFMessage of transforms from parents to children: each ``place``."""
        marks = _Marks()
        headers = [self._header(marks, parent) for parent, _ in frames]
        found = []
        for header, (_, child) in zip(headers, frames, strict=True):
            moved = self._make("geometry_msgs/msg/Transform", *self._pose(marks, "Vector3"))
            found.append(self._make("geometry_msgs/msg/TransformStamped", header, child, moved))
        kind = "tf2_msgs/msg/TFMessage"
        return self._form(kind, self._make(kind, found), len(frames), 7 * len(frames))

    def twist(self, frame: str) -> Form:
        """A TwistStamped: ``velocity``."""
        marks = _Marks()
        kind = "geometry_msgs/msg/TwistStamped"
        header = self._header(marks, frame)
        return self._form(kind, self._make(kind, header, self._twist(marks)), 1, 6)

    def joints(self, names: Sequence[str]) -> Form:
        """A JointState: the positions, then the velocities."""
        marks = _Marks()
        header = self._header(marks, "")
        values = [self._array([marks.number() for _ in names]) for _ in range(2)]
        none = self._array([], dtype=float)
        kind = "sensor_msgs/msg/JointState"
        message = self._make(kind, header, list(names), *values, none)
        return self._form(kind, message, 1, 2 * len(names))

    def _form(self, kind: str, message: Any, times: int, numbers: int) -> Form:
        return Form(bytes(self.store.serialize_cdr(message, kind)), times, numbers)

    def _make(self, kind: str, *values: Any) -> Any:
        return self._types[kind](*values)

    def _header(self, marks: _Marks, frame: str) -> Any:
        return self._make(
            "std_msgs/msg/Header", self._make("builtin_interfaces/msg/Time", *marks.time()), frame
        )

    def _pose(self, marks: _Marks, kind: str) -> tuple[Any, Any]:
        place = self._make(f"geometry_msgs/msg/{kind}", *(marks.number() for _ in range(3)))
        turn = (marks.number() for _ in range(4))
        return place, self._make("geometry_msgs/msg/Quaternion", *turn)

    def _twist(self, marks: _Marks) -> Any:
        along, about = (
            self._make("geometry_msgs/msg/Vector3", *(marks.number() for _ in range(3)))
            for _ in range(2)
        )
        return self._make("geometry_msgs/msg/Twist", along, about)

    def _covariance(self, marks: _Marks) -> Any:
        return self._array([marks.number() for _ in range(36)])


def place(pose: Pose2, posture: Posture = LEVEL) -> tuple[float, ...]:
    """Position and orientation as ROS orders them: x, y, z, and a quaternion xyzw."""
    z, roll, pitch = posture
    w, i, j, k = quat_from_rpy(roll, pitch, pose.yaw)
    return pose.x, pose.y, z, i, j, k, w


def velocity(twist: Twist) -> tuple[float, ...]:
    """Linear and angular."""
    return twist.vx, twist.vy, 0.0, 0.0, 0.0, twist.wz


def covariance(planar: Cov3, yaw: float = 0.0) -> tuple[float, ...]:
    """The 6x6 covariance of ROS in the frame in which this one's has the heading ``yaw``."""
    if planar is ZERO_COV:
        return _UNKNOWN
    (xx, xy, xa), (_, yy, ya), (_, _, aa) = planar
    if yaw:
        c, s = math.cos(yaw), math.sin(yaw)
        xx, xy, yy = (
            c * c * xx - 2.0 * c * s * xy + s * s * yy,
            c * s * (xx - yy) + (c * c - s * s) * xy,
            s * s * xx + 2.0 * c * s * xy + c * c * yy,
        )
        xa, ya = c * xa - s * ya, s * xa + c * ya
    first = (xx, xy, 0.0, 0.0, 0.0, xa, xy, yy, 0.0, 0.0, 0.0, ya)
    return (*first, *_UNKNOWN[:18], xa, ya, 0.0, 0.0, 0.0, aa)
