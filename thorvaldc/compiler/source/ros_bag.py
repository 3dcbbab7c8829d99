"""Reads bags, ours and others': MCAP files, folders of ``ros2 bag record``, and those of ROS 1."""

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
"""The topics of a robot in our records, without its name space, and their types."""
SUFFIXES = (".mcap", ".db3", ".bag")
"""Of files; a folder is a bag if it has ``metadata.yaml``."""


class MissingPackageError(Exception):
    """What a record needs is not there; the message is one line for the user."""


def require_rosbags() -> None:
    """Raises ``MissingPackageError`` where rosbags is missing."""
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError:
        raise MissingPackageError(
            "MCAP files need rosbags, which is not installed: pip install 'thorvaldc[record]'"
        ) from None


@dataclass(frozen=True, slots=True)
class Bag:
    """What was asked for of a bag.

    ``topics`` are the types of all its topics; ``messages`` those of the wanted ones, each with
    its time in s since the beginning of the bag, in order of time.
    """

    topics: Mapping[str, str]
    messages: Mapping[str, list[tuple[float, Any]]]


def is_bag(path: Path) -> bool:
    """Whether it is to be read as a bag, by its name or what lies in it."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path,
    display: str,
    span: Span,
    choose: Callable[[Mapping[str, str]], Collection[str]],
    report: Report,
) -> Bag | None:
    """The bag with the topics that ``choose`` takes of all; ``None`` if it cannot be read.

    ``display`` is what the file is called in a diagnostic, and ``span`` its place.
    Raises ``MissingPackageError`` where rosbags is missing.
    """
    require_rosbags()
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            topics = {c.topic: c.msgtype for c in reader.connections}
            wanted = set(choose(topics))
            messages: dict[str, list[tuple[float, Any]]] = {name: [] for name in topics}
            messages = {name: found for name, found in messages.items() if name in wanted}
            chosen = [c for c in reader.connections if c.topic in wanted]
            for connection, time, data in reader.messages(chosen) if chosen else ():
                message = reader.deserialize(data, connection.msgtype)
                seconds = (time - reader.start_time) / 1e9
                messages[connection.topic].append((seconds, message))
            return Bag(topics, messages)
    except Exception as fault:  # a library that is given broken bytes fails in many ways
        what = " ".join(str(fault).split()).replace(str(path), path.name).rstrip(".")
        report.add(
            "record-unreadable",
            f"`{display}` cannot be read as a bag of ROS: {what or type(fault).__name__}",
            span,
            hint="if it was cut short, `mcap recover` may mend it" if _is_mcap(path) else None,
        )
        return None


def _is_mcap(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(8) == b"\x89MCAP0\r\n"
    except OSError:
        return False
