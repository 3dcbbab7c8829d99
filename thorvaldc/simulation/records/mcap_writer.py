r"""Writes the record of a run as an MCAP file of ROS 2 messages, with the library rosbags.

The message times are the simulated times, from 0 on.  The topics of a robot are in the name space
of the robot:

====================  ===============  ====================================================
``odom``              Odometry         the estimate of the odometry from the encoders
``ground_truth/odom`` Odometry         the true pose with height, roll and pitch
``cmd_vel``           TwistStamped     the commanded twist
``cmd_vel_limited``   TwistStamped     the commanded twist after limits and ramps
``joint_states``      JointState       the joint states that the driver reads
``joint_commands``    JointState       the joint commands of the driver
``robot_description`` String           the URDF with its meshes, see ``robot_description``
====================  ===============  ====================================================

Sensors have the topics that the node has, such as ``lidar/scan``.

The topics ``/tf`` and ``/tf_static`` have these frames::

    map --(static: start pose)--> odom --(estimated)--> base_link --> links of the URDF
     \--(true)--> base_link_true

Without odometry, ``base_link`` is at ``base_link_true``.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import shutil
import struct
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.backends import ros2_parts
from thorvaldc.compiler.recordings import ros_bag
from thorvaldc.diagnostics.files import INCOMPLETE, errors_with_name, uninterrupted, write_file
from thorvaldc.model import Robot, wheel_joints
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import ZERO_COV, Pose2
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.records.foxglove_layout import (
    IN_SCENE,
    LAYOUT_SUFFIX,
    foxglove_layout,
)
from thorvaldc.simulation.records.recorder import SampleInterval
from thorvaldc.simulation.records.robot_description import (
    LinkFrames,
    Transform,
    urdf_with_meshes,
)

if TYPE_CHECKING:
    from thorvaldc.simulation.sensors.simulated_sensor import Message, SimulatedSensor

# -- ROS 2 messages --------------------------------------------------------------------------------

# CDR (OMG DDS-XTypes 7.4, version 1, little-endian) is the byte format of ROS 2 messages::
#
#     00 01 00 00 | sec   | nanosec | length | frame_id \0 | .. | x      | y      | ..
#     header      | int32 | uint32  | uint32 | bytes       | 0s | double | double | ..
#
# The offset of a value, counted from the end of the header, is a multiple of the size of the value.
# A string consists of the length, the characters and a final zero byte.  The length of a CDR string
# includes the zero byte.  A sequence consists of the number of items and the items.
#
# Two messages of the same topic differ only in the times and the numbers.  A ``MessageTemplate``
# thus writes all other bytes only once.  The serialiser of rosbags has the same output as a
# ``MessageTemplate``, but encodes the whole message every time.  A record of the 3,851 samples of
# the mission in ``bench/records.py`` takes 1.9 times the processor time with it, even if the
# message objects are made only once.

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

    def serialized(self, message: Message) -> bytes:
        """Returns the bytes of the message of a sensor."""
        from numpy import asarray

        built = message.build(self._store.types.__getitem__, asarray)
        return bytes(self._store.serialize_cdr(built, message.ros_type))


def latched_qos() -> Any:
    """Returns the quality of service of the topics ``/tf_static`` and ``robot_description``.

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


_TF, _STRING = "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"
_GROUPS = {
    "odometry": (ros_bag.ODOM,),
    "truth": (ros_bag.TRUE_ODOM,),
    "twist": (ros_bag.COMMANDED_TWIST, ros_bag.LIMITED_TWIST),
    "joints": (ros_bag.JOINTS, ros_bag.COMMANDS),
}
OURS = "thorvaldc"
"""Key in the custom data of a bag that marks a record of thorvaldc."""
_NAME = "record"
"""File name in the bag, equal for all files, so that equal runs give equal bytes."""
_BATCH = 500
"""Number of messages per write."""


class McapRecorder:
    """Writes the samples of all robots to one MCAP file, and a layout for Foxglove beside it.

    The arguments ``groups`` and ``every`` have the same meaning as for ``CsvRecorder``.  Two equal
    runs give MCAP files with equal bytes.  During the run, the MCAP file is in a hidden folder next
    to ``path``.  The method ``close`` moves the MCAP file to ``path``, also after an error of the
    run or Ctrl-C.  If the disk is full, it moves the file to ``<path>.incomplete``.
    """

    def __init__(
        self,
        path: Path,
        robots: Sequence[tuple[str, Robot]],
        groups: Sequence[str],
        every: float = 0.0,
    ) -> None:
        """Opens the MCAP file in a hidden folder.

        Raises ``MissingPackageError`` if rosbags is not installed.  Raises ``OSError`` if the file
        cannot be written.
        """
        ros_bag.require_rosbags()
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        self.path = path
        self._shown = robots, groups
        self._interval = SampleInterval(every)
        self._types = MessageTypes()
        self._pending: list[tuple[Any, int, bytes]] = []
        self._failed = False
        self._sensors: dict[tuple[str, str], Any] = {}
        self._static_frames: dict[tuple[str, str], Transform] = {}
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        with errors_with_name(path):
            self._folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        try:
            with errors_with_name(path):
                self._writer = Writer(
                    self._folder / _NAME, version=9, storage_plugin=StoragePlugin.MCAP
                )
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
                self._writer.set_custom_data(OURS, "1")
                self._writer.open()
            topics = [topic for group in _GROUPS if group in groups for topic in _GROUPS[group]]
            self._robots = {name: self._open(robot, topics) for name, robot in robots}
            self.tf = self._connect("/tf", _TF)
            self._tf_static = self._connect("/tf_static", _TF, latched=True)
        except BaseException:
            self._remove_folder()
            raise

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        if not self._interval.is_due(robot, sample.time):
            return
        self._robots[robot].send(sample, commands)
        if len(self._pending) >= _BATCH:
            # Ctrl-C while a message is written would make a whole chunk of the file unreadable.
            with uninterrupted(), self._failing():
                self._write()

    def measured(self, sensor: SimulatedSensor, message: Message) -> None:
        """Queues a message of a sensor for the next write."""
        key = sensor.name, message.ros_type
        if key not in self._sensors:
            topics = {kind: topic for topic, kind, _ in ros2_parts.sensor_topics(sensor.sensor)}
            topic = f"/{sensor.robot.prefix}{topics[message.ros_type]}"
            self._sensors[key] = self._connect(topic, message.ros_type)
        time = round(sensor.seen.data.time * 1e9)
        self.send(self._sensors[key], time, self._types.serialized(message))

    def close(self) -> None:
        if not self._folder.exists():
            return
        with uninterrupted(), errors_with_name(self.path):
            try:
                with self._failing():
                    self._write()
                    self._writer.close()
            except OSError:
                # If the disk is full, the file keeps all messages that were written, but has no
                # index.
                with contextlib.suppress(OSError):
                    self._writer.abort()
                raise
            finally:
                name = f"{self.path}{INCOMPLETE}" if self._failed else self.path
                with contextlib.suppress(FileNotFoundError):
                    os.replace(self._folder / _NAME / f"{_NAME}.mcap", name)
                self._remove_folder()
        if not self._failed:
            in_scene = [c.topic for (_, kind), c in self._sensors.items() if kind in IN_SCENE]
            layout = foxglove_layout(*self._shown, in_scene)
            write_file(self.path.with_suffix(LAYOUT_SUFFIX), layout)

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        with errors_with_name(self.path):
            try:
                yield
            except OSError:
                self._failed = True
                raise

    def send(self, connection: Any, time: int, data: bytes) -> None:
        """Queues a message with the time ``time`` (ns) for the next write."""
        self._pending.append((connection, time, data))

    def send_static_frames(self, time: int, frames: Mapping[tuple[str, str], Transform]) -> None:
        """Queues a message with the static frames of a robot and of all robots before it.

        A late subscriber gets only the last message on the topic.
        """
        self._static_frames |= frames
        message = transforms_template([*self._static_frames])
        numbers = list(chain.from_iterable(self._static_frames.values()))
        self.send(self._tf_static, time, message.encode(time, numbers))

    def _write(self) -> None:
        pending, self._pending = self._pending, []
        for connection, time, data in pending:
            self._writer.write(connection, time, data)

    def _open(self, robot: Robot, topics: Sequence[str]) -> _RobotTopics:
        connections = {
            topic: self._connect(f"/{robot.prefix}{topic}", ros_bag.TYPES[topic])
            for topic in topics
        }
        description = f"/{robot.prefix}{ros_bag.DESCRIPTION}"
        connections[ros_bag.DESCRIPTION] = self._connect(description, _STRING, latched=True)
        return _RobotTopics(robot, connections, self)

    def _connect(self, topic: str, type_name: str, *, latched: bool = False) -> Any:
        definition, type_hash = self._types.definition(type_name)
        return self._writer.add_connection(
            topic,
            type_name,
            msgdef=definition,
            rihs01=type_hash,
            offered_qos_profiles=[latched_qos()] if latched else [],
        )

    def _remove_folder(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


class _RobotTopics:
    """Encodes the samples of one robot as ROS 2 messages.

    ``connections`` has the connection of each topic, by the topic name without the name space.
    """

    def __init__(self, robot: Robot, connections: dict[str, Any], recorder: McapRecorder) -> None:
        self._connections = connections
        self._recorder = recorder
        odom, base = f"{robot.prefix}odom", f"{robot.prefix}base_link"
        true_base = f"{base}_true"
        self._robot = robot
        drives, steering = wheel_joints(robot)
        self._drives, self._steering = list(drives.values()), list(steering.values())
        self._odometry = odometry_template(odom, base)
        self._truth = odometry_template("map", true_base)
        joints = [*drives, *steering]
        self._links = LinkFrames(robot, joints)
        frames = [(odom, base)] if ros_bag.ODOM in connections else []
        self._static_frames = [("map", odom)] if frames else []
        if ros_bag.TRUE_ODOM in connections:
            self._static_frames += [] if frames else [(true_base, base)]
            frames.append(("map", true_base))
        self._frames = transforms_template([*frames, *self._links.moving])
        self._twist = twist_template(base)
        self._joints = joints_template(joints)
        self._start: Pose2 | None = None

    def send(self, sample: Sample, commands: JointCommands | None) -> None:
        """Encodes a sample and queues the messages for the next write."""
        connections, send = self._connections, self._recorder.send
        time = round(sample.time * 1e9)
        poses: tuple[float, ...] = ()
        if self._start is None:
            self._start = sample.pose_estimated if ros_bag.ODOM in connections else se2.ORIGIN
            self._send_description(time, self._start)
        if ros_bag.ODOM in connections:
            local = sample.pose_estimated.relative_to(self._start)
            poses = se2.pose_numbers(local)
            numbers = (
                *poses,
                *se2.covariance_numbers(sample.pose_covariance, local.yaw),
                *se2.twist_numbers(sample.estimated),
                *se2.covariance_numbers(sample.twist_covariance),
            )
            send(connections[ros_bag.ODOM], time, self._odometry.encode(time, numbers))
        if ros_bag.TRUE_ODOM in connections:
            true_pose = se2.pose_numbers(sample.pose_true, sample.posture)
            poses += true_pose
            unknown = se2.covariance_numbers(ZERO_COV)
            numbers = (*true_pose, *unknown, *se2.twist_numbers(sample.true), *unknown)
            send(connections[ros_bag.TRUE_ODOM], time, self._truth.encode(time, numbers))
        poses += self._links.moving_numbers(self._state_numbers(sample.joints))
        if poses:
            send(self._recorder.tf, time, self._frames.encode(time, poses))
        for topic, twist in (
            (ros_bag.COMMANDED_TWIST, sample.commanded),
            (ros_bag.LIMITED_TWIST, sample.limited),
        ):
            if topic in connections:
                send(
                    connections[topic],
                    time,
                    self._twist.encode(time, se2.twist_numbers(twist)),
                )
        if ros_bag.JOINTS in connections and sample.joints is not None:
            data = self._joints.encode(time, self._state_numbers(sample.joints))
            send(connections[ros_bag.JOINTS], time, data)
        if ros_bag.COMMANDS in connections and commands is not None:
            data = self._joints.encode(time, self._command_numbers(commands))
            send(connections[ros_bag.COMMANDS], time, data)

    def _send_description(self, time: int, start: Pose2) -> None:
        """Queues the URDF and the frames that do not move."""
        urdf = MessageTemplate()
        urdf.text(urdf_with_meshes(self._robot))
        self._recorder.send(self._connections[ros_bag.DESCRIPTION], time, urdf.encode(time, ()))
        frames = dict.fromkeys(self._static_frames, se2.pose_numbers(start)) | self._links.fixed
        self._recorder.send_static_frames(time, frames)

    def _state_numbers(self, joints: JointStates | None) -> list[float]:
        """Returns the numbers of a JointState message from joint states.

        The positions of all joints are followed by the velocities of all joints, in the order of
        the joint names.
        """
        drives, steering = self._drives, self._steering
        if joints is None:
            return [math.nan] * (2 * (len(drives) + len(steering)))
        positions = joints.positions
        return [
            *(positions[i] if positions is not None else math.nan for i in drives),
            *(joints.angles[i] for i in steering),
            *(joints.speeds[i] for i in drives),
            *(joints.angle_rates[i] for i in steering),
        ]

    def _command_numbers(self, commands: JointCommands) -> list[float]:
        """Returns the numbers of a JointState message from joint commands.

        A steering joint has a commanded position, and a drive joint has a commanded velocity.  All
        other numbers in the JointState message are nan.
        """
        drives, steering = self._drives, self._steering
        return [
            *(math.nan for _ in drives),
            *(commands.angles[i] for i in steering),
            *(commands.speeds[i] for i in drives),
            *(math.nan for _ in steering),
        ]
