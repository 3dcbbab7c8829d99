"""Reads the section `ros` of a robot document, and checks the names that the robot has in ROS 2."""

from __future__ import annotations

import keyword
import re

from thorvaldc.compiler.modules.value_reader import ValueReader, entries
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.robot import Robot
from thorvaldc.model.ros import MAP_FRAME, ODOM_FRAME, RESERVED_TOPICS, RosSettings

# Python packages that the nodes and launch files of a ROS 2 package import.  A ROS 2 package with
# such a name would hide the Python package.
_IMPORTED = frozenset(
    ["ament_index_python", "can", "launch", "launch_ros", "mujoco", "numpy", "rclpy", "setuptools"]
    + ["std_srvs", "test", "tests", "thorvaldc", "yaml"]
    + [f"{kind}_msgs" for kind in ("diagnostic", "geometry", "nav", "sensor", "std", "tf2")]
)
# The names that REP 144 and the ROS 2 build tools allow; two or more characters.
_PACKAGE = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def read_ros_settings(document: Node, reader: ValueReader, report: Report) -> RosSettings:
    """Returns the settings of the ROS 2 package of a robot.

    The default name of the package is made from the name of the robot.
    """
    node = document.get("ros") or Node({}, document.span)
    default = RosSettings()
    stated = node.get("package")
    package = package_name(reader.text(document.get("name"), default.package))
    if stated is not None:
        package = reader.text(stated, package)
        problem = _package_problem(package)
        if problem is not None:
            report.add(
                "ros-package-name",
                f"`{package}` cannot be the name of a ROS 2 package: {problem}",
                stated.span,
                hint=f"write `{package_name(package)}`, or leave out `package`",
            )
    return RosSettings(
        reader.text(node.get("distro"), default.distro),
        reader.text(node.get("odom_tf"), default.odom_tf),
        package,
    )


def package_name(text: str) -> str:
    """Returns an allowed name of a ROS 2 package that is similar to a text.

    An allowed name of a ROS 2 package does not change.
    """
    words = [word for word in re.split(r"[^a-z0-9]+", text.lower()) if word]
    name = "_".join(words)
    if not name[:1].isalpha():
        name = f"robot_{name}".rstrip("_")
    return name if _package_problem(name) is None else f"{name}_robot"


def _package_problem(name: str) -> str | None:
    """Returns why a ROS 2 package cannot have a name, or ``None`` if it can."""
    if not _PACKAGE.fullmatch(name) or len(name) < 2:
        return (
            "expected two or more lower-case letters, digits and single `_`, with a letter first"
            " and no `_` last"
        )
    if keyword.iskeyword(name) or keyword.issoftkeyword(name):
        return "it is a keyword of Python"
    if name in _IMPORTED:
        return f"it would hide the Python package `{name}`"
    return None


def check_ros_names(robot: Robot, document: Node, report: Report) -> None:
    """Checks the names of the frames and topics that the robot has in ROS 2."""
    _check_frames(robot, report)
    _check_topics(robot, document, report)


def _check_frames(robot: Robot, report: Report) -> None:
    """Reports links whose names cannot be frames in ROS 2."""
    for link in robot.links:
        if link.name.startswith("/"):
            report.add(
                "ros-frame-name",
                f"the link `{link.name}` cannot be a frame: no frame of tf2 begins with `/`",
                link.span,
                hint=f"call it `{link.name.lstrip('/')}`",
            )
        elif link.name in (ODOM_FRAME, MAP_FRAME):
            report.add(
                "ros-frame-reserved",
                f"the link `{link.name}` has the name of a frame that is not part of the robot",
                link.span,
                hint=f"rename the link; localization publishes `{link.name}` (REP 105)",
            )


def _check_topics(robot: Robot, document: Node, report: Report) -> None:
    """Reports sources and locks of twists whose topic is used for something else."""
    driver = document.get("driver") or Node({}, document.span)
    owners: dict[str, tuple[str, Node]] = {}
    for section, inputs in (
        ("twist_sources", robot.twist_sources),
        ("twist_locks", robot.twist_locks),
    ):
        stated = entries(driver.get(section))
        for twist_input in inputs:
            entry = stated.get(twist_input.name, driver)
            node, topic = entry.get("topic") or entry, twist_input.topic
            owner = owners.setdefault(topic, (twist_input.name, node))
            if topic in RESERVED_TOPICS:
                use, labels = RESERVED_TOPICS[topic], []
            elif owner[0] != twist_input.name:
                use, labels = f"that of `{owner[0]}`", [Label(owner[1].where, "first used here")]
            else:
                continue
            report.add(
                "ros-topic-duplicate",
                f"`{twist_input.name}` has the topic `{topic}`, which is also {use}",
                node.span,
                hint="give each source and each lock its own topic",
                labels=labels,
            )
