"""Records of runs as one MCAP file of ROS 2 messages, written by rosbags.

Of each robot, under its name space, at simulated times from 0 on:

====================  ===============  ====================================================
``odom``              Odometry         what the odometry makes of the encoders
``ground_truth/odom`` Odometry         where the robot is, with height, roll and pitch
``cmd_vel``           TwistStamped     what is asked for
``cmd_vel_limited``   TwistStamped     the same within limits and ramps
``joint_states``      JointState       as the driver is told them
``joint_commands``    JointState       what the driver asks of the joints
====================  ===============  ====================================================

``/tf`` and ``/tf_static`` have the frames ``map`` to ``odom`` (fixed, where it started) to
``base_link`` (estimated), and ``map`` to ``base_link_true``.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.ros_bag import (
    COMMANDED_TWIST,
    COMMANDS,
    JOINTS,
    LIMITED_TWIST,
    ODOM,
    TRUE_ODOM,
    TYPES,
    require_rosbags,
)
from thorvaldc.diagnostics.interrupts import uninterrupted
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import ZERO_COV, Pose2
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.records.recorder import SampleInterval, errors_with_name
from thorvaldc.simulation.records.ros_messages import RosMessages, covariance, place, velocity

_TF = "tf2_msgs/msg/TFMessage"
_GROUPS = {
    "odometry": (ODOM,),
    "truth": (TRUE_ODOM,),
    "twist": (COMMANDED_TWIST, LIMITED_TWIST),
    "joints": (JOINTS, COMMANDS),
}
OURS = "thorvaldc"
"""The key in a bag's custom data by which a record is known as ours."""
_NAME = "record"
"""What a bag is called within: the bytes shall not depend on where the file lies."""
_BATCH = 500
"""Messages that are handed to the file at once."""


class McapRecorder:
    """One MCAP file of all robots; ``groups`` and ``every`` as of ``CsvRecorder``.

    The same run gives the same bytes.  While it runs the file grows in a hidden folder beside
    its place, which it takes when the recorder is closed, whatever ended the run.
    """

    def __init__(
        self,
        path: Path,
        robots: Sequence[tuple[str, Robot]],
        groups: Sequence[str],
        every: float = 0.0,
    ) -> None:
        """Raises ``MissingPackageError`` without rosbags, ``OSError`` if it cannot be written."""
        require_rosbags()
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        self.path = path
        self._interval = SampleInterval(every)
        self._make = RosMessages()
        self._pending: list[tuple[Any, int, bytes]] = []
        self._tf: Any = None
        self._tf_static: Any = None
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
            if ODOM in topics or TRUE_ODOM in topics:
                self._tf = self._connect("/tf", _TF)
            if ODOM in topics:
                self._tf_static = self._connect("/tf_static", _TF, latched=True)
        except BaseException:
            self._drop()
            raise

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        if not self._interval.is_due(robot, sample.time):
            return
        self._robots[robot].say(sample, commands)
        if len(self._pending) >= _BATCH:
            # A message that is written by half would spoil all that is written with it.
            with uninterrupted(), errors_with_name(self.path):
                self._write()

    def close(self) -> None:
        if not self._folder.exists():
            return
        with uninterrupted(), errors_with_name(self.path):
            try:
                self._write()
                self._writer.close()
            except OSError:
                # The disk is full: what there is of the file is kept, without an index.
                with contextlib.suppress(OSError):
                    self._writer.abort()
                raise
            finally:
                with contextlib.suppress(FileNotFoundError):
                    os.replace(self._folder / _NAME / f"{_NAME}.mcap", self.path)
                self._drop()

    def send(self, connection: Any, time: int, data: bytes) -> None:
        """Queue a message for ``time`` in ns."""
        self._pending.append((connection, time, data))

    def _write(self) -> None:
        pending, self._pending = self._pending, []
        for connection, time, data in pending:
            self._writer.write(connection, time, data)

    def _open(self, robot: Robot, topics: Sequence[str]) -> _RobotTopics:
        prefix = robot.prefix
        found = {topic: self._connect(f"/{prefix}{topic}", TYPES[topic]) for topic in topics}
        return _RobotTopics(robot, prefix, found, self, self._make)

    def _connect(self, topic: str, kind: str, *, latched: bool = False) -> Any:
        qos = [self._make.latched()] if latched else []
        text, digest = self._make.definition(kind)
        return self._writer.add_connection(
            topic, kind, msgdef=text, rihs01=digest, offered_qos_profiles=qos
        )

    def send_tf(self, time: int, data: bytes, *, static: bool = False) -> None:
        """Queue a TFMessage."""
        self.send(self._tf_static if static else self._tf, time, data)

    def _drop(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


class _RobotTopics:
    """The topics of one robot, by their names without its name space."""

    def __init__(
        self,
        robot: Robot,
        prefix: str,
        topics: dict[str, Any],
        recorder: McapRecorder,
        make: RosMessages,
    ) -> None:
        self._topics = topics
        self._recorder = recorder
        odom, base = f"{prefix}odom", f"{prefix}base_link"
        drives, steering = recorded_joints(robot)
        self._drives, self._steering = list(drives.values()), list(steering.values())
        self._odometry = make.odometry(odom, base)
        self._truth = make.odometry("map", f"{base}_true")
        self._start_frame = make.transforms([("map", odom)])
        frames = [(odom, base)] * (ODOM in topics) + [("map", f"{base}_true")] * (
            TRUE_ODOM in topics
        )
        self._frames = make.transforms(frames)
        self._twist = make.twist(base)
        self._joints = make.joints([*drives, *steering])
        self._start: Pose2 | None = None

    def say(self, sample: Sample, commands: JointCommands | None) -> None:
        topics, send = self._topics, self._recorder.send
        time = round(sample.time * 1e9)
        places: tuple[float, ...] = ()
        if ODOM in topics:
            if self._start is None:
                self._start = sample.pose_estimated
                data = self._start_frame.bytes(time, place(self._start))
                self._recorder.send_tf(time, data, static=True)
            pose = sample.pose_estimated.relative_to(self._start)
            where = places = place(pose)
            known = covariance(sample.pose_covariance, pose.yaw)
            moving = (*velocity(sample.estimated), *covariance(sample.twist_covariance))
            send(topics[ODOM], time, self._odometry.bytes(time, (*where, *known, *moving)))
        if TRUE_ODOM in topics:
            where = place(sample.pose_true, sample.posture)
            places += where
            none = covariance(ZERO_COV)
            numbers = (*where, *none, *velocity(sample.true), *none)
            send(topics[TRUE_ODOM], time, self._truth.bytes(time, numbers))
        if places:
            self._recorder.send_tf(time, self._frames.bytes(time, places))
        for topic, twist in ((COMMANDED_TWIST, sample.commanded), (LIMITED_TWIST, sample.limited)):
            if topic in topics:
                send(topics[topic], time, self._twist.bytes(time, velocity(twist)))
        if JOINTS in topics and sample.joints is not None:
            send(topics[JOINTS], time, self._joints.bytes(time, self._states(sample.joints)))
        if COMMANDS in topics and commands is not None:
            send(topics[COMMANDS], time, self._joints.bytes(time, self._asked(commands)))

    def _states(self, joints: JointStates) -> list[float]:
        """Positions, then velocities, in the order of the names."""
        drives, steering = self._drives, self._steering
        turned = joints.positions
        found = [turned[i] if turned is not None else math.nan for i in drives]
        found += [joints.angles[i] for i in steering]
        found += [joints.speeds[i] for i in drives]
        return found + [joints.angle_rates[i] for i in steering]

    def _asked(self, commands: JointCommands) -> list[float]:
        """A position of each steering joint, a velocity of each drive; else nan."""
        drives, steering = self._drives, self._steering
        found = [math.nan] * len(drives) + [commands.angles[i] for i in steering]
        return found + [commands.speeds[i] for i in drives] + [math.nan] * len(steering)


def recorded_joints(robot: Robot) -> tuple[dict[str, int], dict[str, int]]:
    """The joints that are recorded, with the index of (the first of) their wheels.

    First those by which driven wheels spin, then those that steer.
    """
    drives: dict[str, int] = {}
    steering: dict[str, int] = {}
    for i, wheel in enumerate(robot.wheels):
        if wheel.driven:
            drives.setdefault(wheel.spin_joint, i)
        if wheel.steering_joint is not None:
            steering.setdefault(wheel.steering_joint, i)
    return drives, steering
