"""Reads the section `ros` of a robot document, and checks the names that the robot has in ROS 2."""

from __future__ import annotations

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Label, Proposal, Report
from thorvaldc.model import Robot
from thorvaldc.model.ros import (
    MAP_FRAME,
    ODOM_FRAME,
    RESERVED_TOPICS,
    RosSettings,
    package_name,
    package_problem,
)


def read_ros_settings(section: Section, robot_name: str, report: Report) -> RosSettings:
    """Returns the settings of the ROS 2 package of a robot: the section `ros` of its document.

    The default name of the package is made from the name of the robot.
    """
    package = section.get("package", package_name(robot_name or RosSettings().package))
    if "package" in section:
        problem = package_problem(package)
        if problem is not None:
            report.add(
                "ros-package-name",
                f"`{package}` cannot be the name of a ROS 2 package: {problem}",
                section.entry("package").span,
                hint=Proposal(
                    f"write `{package_name(package)}`, or leave out `package`",
                    package_name(package),
                ),
            )
    return RosSettings(section["distro"], section["odom_tf"], package)


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
