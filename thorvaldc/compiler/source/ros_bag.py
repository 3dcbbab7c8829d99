"""Reads ROS bags: MCAP files, folders of ``ros2 bag record``, and ROS 1 bags."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics import Report, Span

ODOM, TRUE_ODOM = "odom", "ground_truth/odom"
COMMANDED_TWIST, LIMITED_TWIST = "cmd_vel", "cmd_vel_limited"
JOINTS, COMMANDS = "joint_states", "joint_commands"
TYPES = {
    ODOM: "nav_msgs/msg/Odometry",
    TRUE_ODOM: "nav_msgs/msg/Odometry",
    COMMANDED_TWIST: "geometry_msgs/msg/TwistStamped",
    LIMITED_TWIST: "geometry_msgs/msg/TwistStamped",
    JOINTS: "sensor_msgs/msg/JointState",
    COMMANDS: "sensor_msgs/msg/JointState",
}
"""Topics of a robot in a record, without the namespace, with their message types."""
SUFFIXES = (".mcap", ".db3", ".bag")
"""Suffixes of bag files.  A folder is a bag if it contains ``metadata.yaml``."""


class MissingPackageError(Exception):
    """An optional package is not installed; the message is one line for the user."""


def require_rosbags() -> None:
    """Raises ``MissingPackageError`` if rosbags is not installed."""
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError:
        raise MissingPackageError(
            "MCAP files require rosbags, which is not installed: pip install 'thorvaldc[record]'"
        ) from None


@dataclass(frozen=True, slots=True)
class Bag:
    """Messages of selected topics of a bag.

    ``topics`` maps every topic of the bag to its type.  ``messages`` maps each selected topic
    to its messages in order of time, each with its time in s since the start of the bag.
    """

    topics: Mapping[str, str]
    messages: Mapping[str, list[tuple[float, Any]]]


def is_bag(path: Path) -> bool:
    """Returns whether the path is a bag, by its suffix or its content."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path,
    display: str,
    span: Span,
    choose: Callable[[Mapping[str, str]], Collection[str]],
    report: Report,
) -> Bag | None:
    """Reads the topics of a bag that ``choose`` selects; ``None`` if the bag is unreadable.

    ``choose`` receives the types of all topics.  ``display`` is the name of the file in
    diagnostics, ``span`` their span.  Raises ``MissingPackageError`` without rosbags.
    """
    require_rosbags()
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            topics = {c.topic: c.msgtype for c in reader.connections}
            selected = set(choose(topics))
            messages: dict[str, list[tuple[float, Any]]] = {
                name: [] for name in topics if name in selected
            }
            connections = [c for c in reader.connections if c.topic in selected]
            # Without connections, rosbags would read all of them.
            for connection, time, data in reader.messages(connections) if connections else ():
                message = reader.deserialize(data, connection.msgtype)
                seconds = (time - reader.start_time) / 1e9
                messages[connection.topic].append((seconds, message))
            return Bag(topics, messages)
    except Exception as error:  # rosbags raises many types of exceptions on broken bytes
        reason = " ".join(str(error).split()).replace(str(path), path.name).rstrip(".")
        report.add(
            "record-unreadable",
            f"`{display}` cannot be read as a ROS bag: {reason or type(error).__name__}",
            span,
            hint="if the file is truncated, `mcap recover` may repair it"
            if _is_mcap(path)
            else None,
        )
        return None


def _is_mcap(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(8) == b"\x89MCAP0\r\n"
    except OSError:
        return False
