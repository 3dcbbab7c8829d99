"""Encodes the ROS 2 messages of a record as CDR.  Times of ROS messages are in ns, and other values
are in SI units.

CDR (OMG DDS-XTypes 7.4, version 1, little-endian) is the byte format of ROS 2 messages::

    00 01 00 00 | sec   | nanosec | length | frame_id \\0 | .. | x      | y      | ..
    header      | int32 | uint32  | uint32 | bytes       | 0s | double | double | ..

The offset of a value, counted from the end of the header, is a multiple of the size of the value.
A string consists of the length, the characters and a final zero byte.  The length of a CDR string
includes the zero byte.  A sequence consists of the number of items and the items.

Two messages of the same topic differ only in the times and the numbers.  A ``MessageTemplate``
thus writes all other bytes only once.  The serialiser of rosbags has the same output as a
``MessageTemplate``, but encodes the whole message every time.  A recorded run of the 77 s mission
in ``bench/records.py`` takes 1.02 s with the serialiser of rosbags, and 0.77 s with message
templates.  The same run without a record takes 0.53 s.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

_NANOSECONDS = 1_000_000_000
_CDR_HEADER = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_POSE_NUMBERS, _TWIST_NUMBERS, _COVARIANCE_NUMBERS = 7, 6, 36


class MessageTemplate:
    """The bytes of a ROS 2 message with gaps for times and numbers (float64)."""

    def __init__(self) -> None:
        self._data = bytearray(_CDR_HEADER)
        self._stamps: list[int] = []
        # Each item is (offset, format, first, end) of a block of adjacent numbers.  One call of
        # struct writes all numbers of a block.
        self._runs: list[tuple[int, struct.Struct, int, int]] = []
        self._count = 0

    def stamp(self) -> None:
        """Appends a gap for a time to the template."""
        self._align(4)
        self._stamps.append(len(self._data))
        self._data += bytes(_STAMP.size)

    def text(self, text: str) -> None:
        """Appends the string ``text`` to the template."""
        data = text.encode() + b"\0"
        self.count(len(data))
        self._data += data

    def count(self, count: int) -> None:
        """Appends ``count``, the length of a sequence or string, to the template."""
        self._align(4)
        self._data += struct.pack("<I", count)

    def numbers(self, count: int) -> None:
        """Appends gaps for ``count`` numbers to the template."""
        self._align(8)
        run = struct.Struct(f"<{count}d")
        self._runs.append((len(self._data), run, self._count, self._count + count))
        self._data += bytes(run.size)
        self._count += count

    def header(self, frame: str) -> None:
        """Appends a ``std_msgs/Header`` with a gap for the time to the template."""
        self.stamp()
        self.text(frame)

    def _align(self, size: int) -> None:
        self._data += bytes(-(len(self._data) - len(_CDR_HEADER)) % size)

    def encode(self, time: int, numbers: Sequence[float]) -> bytes:
        """Returns the bytes of a ROS message with the given time and numbers.

        The function writes ``time`` (ns) into all gaps for times, and ``numbers`` into the gaps for
        numbers.
        """
        data = self._data
        for offset in self._stamps:
            _STAMP.pack_into(data, offset, *divmod(time, _NANOSECONDS))
        for offset, run, first, end in self._runs:
            run.pack_into(data, offset, *numbers[first:end])
        return bytes(data)


def odometry_template(frame: str, child: str) -> MessageTemplate:
    """Returns the template of a ``nav_msgs/Odometry`` message.

    The numbers are the pose, the covariance of the pose, the twist, and the covariance of the
    twist.
    """
    message = MessageTemplate()
    message.header(frame)
    message.text(child)
    message.numbers(_POSE_NUMBERS + _COVARIANCE_NUMBERS + _TWIST_NUMBERS + _COVARIANCE_NUMBERS)
    return message


def transforms_template(frames: Sequence[tuple[str, str]]) -> MessageTemplate:
    """Returns the template of a ``tf2_msgs/TFMessage`` message.

    ``frames`` has a tuple (parent frame, child frame) for each transform.  The numbers in the
    message are the poses of the child frames.
    """
    message = MessageTemplate()
    message.count(len(frames))
    for parent, child in frames:
        message.header(parent)
        message.text(child)
        message.numbers(_POSE_NUMBERS)
    return message


def twist_template(frame: str) -> MessageTemplate:
    """Returns the template of a ``geometry_msgs/TwistStamped`` message.

    The numbers in the message are the components of the twist.
    """
    message = MessageTemplate()
    message.header(frame)
    message.numbers(_TWIST_NUMBERS)
    return message


def joints_template(names: Sequence[str]) -> MessageTemplate:
    """Returns the template of a ``sensor_msgs/JointState`` message without efforts.

    The numbers are the positions of all joints, followed by the velocities of all joints.
    """
    message = MessageTemplate()
    message.header("")
    message.count(len(names))
    for name in names:
        message.text(name)
    for _ in ("position", "velocity"):
        message.count(len(names))
        if names:
            message.numbers(len(names))
    message.count(0)
    return message


class MessageTypes:
    """The definitions of ROS message types from the library rosbags."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._definitions: dict[str, tuple[str, str]] = {}

    def definition(self, type_name: str) -> tuple[str, str]:
        """Returns the text of a message definition and the type hash of REP 2016."""
        if type_name not in self._definitions:
            text, _ = self._store.generate_msgdef(type_name, ros_version=2)
            self._definitions[type_name] = (str(text), self._store.hash_rihs01(type_name))
        return self._definitions[type_name]


def latched_qos() -> Any:
    """Returns the quality of service of the topic ``/tf_static``.

    A subscriber that connects after the message was sent also receives the message.
    """
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
