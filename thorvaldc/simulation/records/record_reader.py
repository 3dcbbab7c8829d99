"""Reads recorded runs: MCAP files, ROS bags with the same topics, and CSV files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from thorvaldc.compiler.recordings import ros_bag
from thorvaldc.compiler.recordings.csv_table import TIME
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Robot, wheel_joints
from thorvaldc.model.scenario import GROUPS
from thorvaldc.model.spatial import matrix_to_rpy, quat_to_matrix
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.runtime.se2 import ORIGIN, Pose2, Twist
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.records import joint_csv
from thorvaldc.simulation.records.csv_record import COLUMNS, commands_of, read_csv_record, sample_of
from thorvaldc.simulation.records.recorder import RecordedRun, report_missing_robot


def read_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    """Returns the recorded runs by robot name.

    ``path`` is an MCAP file, a folder of CSV files or the CSV file of one robot.  The robot name
    in a record of a single robot may differ from the name in ``robots``.  If the record is invalid,
    the function adds the problems to ``report`` and returns ``None``.  Raises
    ``MissingPackageError`` if the record is an MCAP file and rosbags is not installed.
    """
    display = str(path)
    if not path.exists():
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
        return None
    read = read_mcap_record if ros_bag.is_bag(path) else read_csv_record
    runs = read(path, robots, report)
    if runs is None or report.has_errors:
        return None
    for name, run in runs.items():
        if not run.samples:
            report.add("record-unreadable", f"`{display}` has no samples of {name}", Span(display))
            return None
    return runs


# -- MCAP files and bags ------------------------------------------------------------------------


def read_mcap_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    """Returns the recorded runs by robot name.

    If the bag is invalid, the function adds the problems to ``report`` and returns ``None``.
    Raises ``MissingPackageError`` if rosbags is not installed.
    """
    display = str(path)
    bag = ros_bag.read_bag(path, display, Span(display), _record_topics, report)
    if bag is None:
        return None
    topics_of: dict[str, dict[str, str]] = {}  # by name space: the topics by their last part
    for topic in bag.messages:
        for kind in ros_bag.TYPES:
            if topic.endswith(f"/{kind}") and not (
                kind == ros_bag.ODOM and topic.endswith(f"/{ros_bag.TRUE_ODOM}")
            ):
                namespace = topic.removesuffix(f"/{kind}").strip("/")
                topics_of.setdefault(namespace, {})[kind] = topic
    topics_of = {
        namespace: topics
        for namespace, topics in topics_of.items()
        if {ros_bag.ODOM, ros_bag.TRUE_ODOM} & set(topics)
    }
    if not topics_of:
        names = ", ".join(sorted(bag.topics)[:6]) or "none"
        report.add(
            "record-unreadable",
            f"`{display}` is not a record of a run: it has no topic `{ros_bag.TRUE_ODOM}` or "
            f"`{ros_bag.ODOM}`",
            Span(display),
            hint=f"its topics: {names}",
        )
        return None
    runs: dict[str, RecordedRun] = {}
    for name, robot in robots:
        namespace = robot.namespace
        if namespace not in topics_of and len(robots) == len(topics_of) == 1:
            namespace = next(iter(topics_of))
        if namespace not in topics_of:
            report_missing_robot(name, topics_of, display, report)
            continue
        run = _BagRun(bag, topics_of[namespace], namespace, robot, display).read(report)
        if run is not None:
            runs[name] = run
    return runs if len(runs) == len(robots) else None


def _record_topics(topics: Mapping[str, str]) -> set[str]:
    """Returns the topics of a bag that belong to a record.

    ``topics`` has the message type of each topic of the bag.
    """
    of_robots = {
        topic
        for topic, type_ in topics.items()
        if any(
            topic.endswith(f"/{kind}") and type_ == ros_bag.TYPES[kind] for kind in ros_bag.TYPES
        )
    }
    return of_robots | ({"/tf_static"} & set(topics))


class _BagRun:
    """The messages of one robot in a bag, grouped by time.

    A sample of a record consists of messages on several topics.  All ROS messages of a sample have
    the same time.
    """

    def __init__(
        self,
        bag: ros_bag.Bag,
        topics: Mapping[str, str],
        namespace: str,
        robot: Robot,
        display: str,
    ) -> None:
        self._by_time: dict[str, dict[float, Any]] = {
            kind: dict(bag.messages[topic]) for kind, topic in topics.items()
        }
        self._robot = robot
        self._display = display
        self._start = ORIGIN
        odom = f"{namespace}/odom" if namespace else "odom"
        for _, message in bag.messages.get("/tf_static", ()):
            for transform in message.transforms:
                if transform.child_frame_id == odom:
                    pose = transform.transform
                    self._start = _pose(pose.translation, pose.rotation, 0.0)[0]

    def read(self, report: Report) -> RecordedRun | None:
        """Returns the recorded run of the robot.

        Returns ``None`` if ROS messages are missing or belong to another robot.
        """
        topic_of = {
            "odometry": ros_bag.ODOM,
            "truth": ros_bag.TRUE_ODOM,
            "twist": ros_bag.COMMANDED_TWIST,
            "joints": ros_bag.JOINTS,
        }
        groups = tuple(group for group in GROUPS if topic_of[group] in self._by_time)
        if not self._joints_match(report):
            return None
        samples: list[Sample] = []
        commands: list[JointCommands | None] = []
        topics = [topic_of[group] for group in groups]
        last_time = next(reversed(self._by_time[topics[0]]), None)
        last_yaws = [0.0, 0.0]
        for time in self._by_time[topics[0]]:
            if not all(time in self._by_time[topic] for topic in topics):
                if time == last_time:
                    continue  # Ctrl-C ended the run between two messages of a sample
                report.add(
                    "record-unreadable",
                    f"`{self._display}` is not a record of a run: at {time:.9g} s a message is "
                    f"missing on one of the topics {', '.join(topics)}",
                    Span(self._display),
                )
                return None
            cells = self._cells(time, last_yaws)
            samples.append(sample_of(cells, self._robot, "joints" in groups))
            has_commands = self._message(ros_bag.COMMANDS, time) is not None
            commands.append(commands_of(cells, self._robot) if has_commands else None)
        return RecordedRun(groups, samples, commands)

    def _joints_match(self, report: Report) -> bool:
        """Checks that the recorded joint names are the joint names of the robot."""
        first = next(iter(self._by_time.get(ros_bag.JOINTS, {}).values()), None)
        if first is None:
            return True
        drives, steering = wheel_joints(self._robot)
        expected = (*drives, *steering)
        recorded = list(first.name)
        unknown = next((name for name in recorded if name not in expected), None)
        missing = next((name for name in expected if name not in recorded), None)
        if unknown is not None or missing is not None:
            report.add(
                "record-robot",
                f"`{self._display}` has a joint `{unknown}`, and {self._robot.name} has not"
                if unknown is not None
                else f"`{self._display}` has no joint `{missing}` of {self._robot.name}",
                Span(self._display),
                hint="is it the record of another robot?",
            )
            return False
        return True

    def _cells(self, time: float, last_yaws: list[float]) -> dict[str, float]:
        """Returns the recorded values at the time ``time``, by their column in a CSV record.

        ``last_yaws`` are the estimated and the true yaw (rad) of the previous sample.  The function
        replaces the yaw angles in ``last_yaws`` by the yaw angles of the returned sample.
        """
        cells = {TIME: time}
        values: tuple[float, ...]
        message = self._message(ros_bag.ODOM, time)
        if message is not None:
            pose_message = message.pose.pose
            local, _ = _pose(pose_message.position, pose_message.orientation, last_yaws[0])
            last_yaws[0] = local.yaw
            values = (*self._start.moved(local), *_twist(message.twist.twist))
            cells |= zip(COLUMNS["odometry"], values, strict=True)
        message = self._message(ros_bag.TRUE_ODOM, time)
        if message is not None:
            pose_message = message.pose.pose
            pose, posture = _pose(pose_message.position, pose_message.orientation, last_yaws[1])
            last_yaws[1] = pose.yaw
            values = (*pose, *_twist(message.twist.twist), *posture)
            cells |= zip(COLUMNS["truth"], values, strict=True)
        twists = [self._message(t, time) for t in (ros_bag.COMMANDED_TWIST, ros_bag.LIMITED_TWIST)]
        for name, message in zip(("asked", "aimed"), twists, strict=True):
            if message is not None:
                names = [f"{name}_{part}" for part in Twist._fields]
                cells |= zip(names, _twist(message.twist), strict=True)
        for topic, quantities in (
            (ros_bag.JOINTS, (joint_csv.POSITION, joint_csv.VELOCITY)),
            (ros_bag.COMMANDS, (joint_csv.POSITION_COMMAND, joint_csv.COMMAND)),
        ):
            message = self._message(topic, time)
            if message is not None:
                for quantity, numbers in zip(
                    quantities, (message.position, message.velocity), strict=True
                ):
                    names = [joint_csv.joint_column(joint, quantity) for joint in message.name]
                    cells |= zip(names, numbers.tolist(), strict=False)
        return cells

    def _message(self, topic: str, time: float) -> Any:
        return self._by_time[topic].get(time) if topic in self._by_time else None


def _twist(message: Any) -> Twist:
    return Twist(message.linear.x, message.linear.y, message.angular.z)


def _pose(
    position: Any, orientation: Any, last_yaw: float
) -> tuple[Pose2, tuple[float, float, float]]:
    """Returns the planar pose, and the height (m), roll (rad) and pitch (rad), of a message.

    A quaternion determines the yaw angle only up to full turns.  The function returns the yaw
    angle that differs from ``last_yaw`` by at most half a turn.
    """
    q = orientation
    roll, pitch, yaw = matrix_to_rpy(quat_to_matrix((q.w, q.x, q.y, q.z)))
    yaw = last_yaw + math.remainder(yaw - last_yaw, math.tau)
    return Pose2(position.x, position.y, yaw), (position.z, roll, pitch)
