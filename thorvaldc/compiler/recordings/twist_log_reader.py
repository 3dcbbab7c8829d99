"""Reads the commanded twists of a scenario from a CSV file or a ROS bag."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from thorvaldc.compiler.recordings import ros_bag
from thorvaldc.compiler.recordings.csv_table import TIME, read_columns, read_header
from thorvaldc.diagnostics import Report, Span, did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.scenario import Command

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
_COMPONENTS = ("vx", "vy", "wz")
_LARGEST = 1e9  # Largest plausible velocity in a log file (m/s or rad/s).
LONGEST_LOG = 1e6
"""Longest duration (s) of a CSV file; a longer one has its times in ms, us or ns."""


def read_twists(
    path: Path,
    display: str,
    span: Span,
    robots: Sequence[tuple[str, Robot]],
    topic: str,
    files: dict[str, Path],
    report: Report,
) -> dict[str, tuple[Command, ...]]:
    """Returns the commanded twists of each robot in a log file, by the name of the robot.

    The time of each command is in seconds from the start of the log file.

    Parameters
    ----------
    path : path of a record folder, a ROS bag or a CSV file.
    display : name of the log in diagnostics.
    span : span of the name of the log in the document.
    robots : name and model of each robot.
    topic : name of a topic in a ROS bag.  Empty: the topic is chosen by the name of each robot.
    files : the function adds each file that was read, by the name of the file in spans.
    """
    if ros_bag.is_bag(path):
        bag_files = sorted(path.iterdir()) if path.is_dir() else [path]
        files.update((f"{display}/{f.name}" if path.is_dir() else display, f) for f in bag_files)
        return _read_bag(path, display, span, robots, topic, report)
    if topic:
        report.add("script-log", f"`{display}` is not a ROS bag: it has no topics", span)
        return {}
    if not path.is_dir():
        files[display] = path
        log = _read_csv(path, display, report)
        return _from_the_beginning({name: log or (math.inf, []) for name, _ in robots})
    logs: dict[str, tuple[float, list[Command]]] = {}
    for name, _ in robots:
        file, file_display = path / f"{name}.csv", f"{display}/{name}.csv"
        if not file.is_file():
            report.add("script-log", f"`{display}` has no file {name}.csv, for {name}", span)
            continue
        files[file_display] = file
        log = _read_csv(file, file_display, report)
        if log is not None:
            logs[name] = log
    return _from_the_beginning(logs)


def _from_the_beginning(
    logs: dict[str, tuple[float, list[Command]]],
) -> dict[str, tuple[Command, ...]]:
    """Returns the commands of logs with times from the first line of all logs.

    The times of a log can be times of day, or begin in the middle of a drive.
    """
    beginning = min((time for time, _ in logs.values()), default=math.inf)
    return {
        name: tuple(replace(command, time=command.time - beginning) for command in commands)
        for name, (_, commands) in logs.items()
    }


def _read_csv(path: Path, display: str, report: Report) -> tuple[float, list[Command]] | None:
    """Reads the time of the first line of a CSV file, and its commanded twists.

    The CSV file is a record of this program or a file of the user.  If it has no column for a
    component of the twist, the component is 0.
    """
    header = read_header(path, display, report)
    if header is None:
        return None
    prefix = "asked_" if "asked_vx" in header.names else ""
    names = [prefix + component for component in _COMPONENTS]
    if not any(name in header.names for name in names):
        report.add(
            "script-log",
            f"`{display}` has no velocities: no column `asked_vx` of a record, nor `vx`, "
            "`vy` or `wz`",
            header.span,
        )
        return None
    columns = read_columns(header, report)
    if columns is None:
        return None
    times = columns[TIME]
    if not times or times[-1] - times[0] > LONGEST_LOG:
        message = "has no lines" if not times else f"lasts {times[-1] - times[0]:.3g} s"
        hint = "write the times in s" if times else None
        report.add("script-log", f"`{display}` {message}", header.span, hint=hint)
        return None
    zeros = [0.0] * len(times)
    commands: list[Command] = []
    for row in zip(times, *(columns.get(name, zeros) for name in names), strict=True):
        if not all(map(math.isfinite, row)):
            message = f"`{display}` has no velocity at {row[0]:.6g} s"
            report.add("script-log", message, header.span)
            return None
        _append(commands, Command(*row))
    return (times[0] if times else math.inf), commands


def _append(commands: list[Command], command: Command) -> None:
    """Appends a command to the list, unless the last command in the list has the same twist."""
    last = commands[-1] if commands else Command(0.0, 0.0, 0.0, 0.0)
    if (command.vx, command.vy, command.wz) != (last.vx, last.vy, last.wz):
        commands.append(command)


# -- bags -----------------------------------------------------------------------------


def _read_bag(
    path: Path,
    display: str,
    span: Span,
    robots: Sequence[tuple[str, Robot]],
    topic: str,
    report: Report,
) -> dict[str, tuple[Command, ...]]:
    """Reads the commanded twists of each robot from a ROS bag, by the name of the robot."""

    def choose_topics(topics: Mapping[str, str]) -> list[str]:
        return _twist_topics(topics) if not topic else [topic] if topic in topics else []

    try:
        bag = ros_bag.read_bag(path, display, span, choose_topics, report)
    except ros_bag.MissingPackageError as error:
        report.add("script-log", str(error), span)
        return {}
    if bag is None:
        return {}
    candidates = _twist_topics(bag.topics)
    if topic and topic not in candidates:
        problem = f"has the type {bag.topics[topic]}" if topic in bag.topics else "does not exist"
        report.add(
            "script-log",
            f"the topic `{topic}` of `{display}` {problem}; expected a Twist or TwistStamped",
            span,
            hint=did_you_mean(topic, candidates, _list_topics(candidates)),
        )
        return {}
    commands_by_robot: dict[str, tuple[Command, ...]] = {}
    for name, robot in robots:
        robot_topic = topic or _topic_of(name, candidates)
        if robot_topic is None:
            report.add(
                "script-log",
                f"`{display}` has "
                + (f"{len(candidates)} topics" if candidates else "no topic")
                + f" with velocities, and none is `/{name}/{ros_bag.COMMANDED_TWIST}`",
                span,
                hint=f"add `topic:`; {_list_topics(candidates)}" if candidates else None,
            )
            continue
        # In a record of this program, each commanded twist is valid until the next commanded twist.
        # In the log of a real robot, each commanded twist is valid for the command time-out of the
        # base driver.  Only records of this program contain a topic with limited twists.
        limited_topic = (
            f"{robot_topic.removesuffix(ros_bag.COMMANDED_TWIST)}{ros_bag.LIMITED_TWIST}"
        )
        timeout = math.inf if limited_topic in bag.topics else robot.driver.command_timeout
        commands = _commands_of_messages(bag.messages[robot_topic], timeout)
        if commands is None:
            report.add(
                "script-log",
                f"`{robot_topic}` of `{display}` has a velocity that is no number or above "
                f"{_LARGEST:g}",
                span,
            )
            continue
        commands_by_robot[name] = commands
    return commands_by_robot


def _twist_topics(topics: Mapping[str, str]) -> list[str]:
    """Returns the sorted names of the ROS topics that contain commanded twists.

    Topics with limited twists in records of this program are left out.
    """
    twists = {name for name, type_ in topics.items() if type_ in (TWIST, TWIST_STAMPED)}
    limited_suffix = f"/{ros_bag.LIMITED_TWIST}"
    limited_twists = {
        name
        for name in twists
        if name.endswith(limited_suffix)
        and f"{name.removesuffix(ros_bag.LIMITED_TWIST)}{ros_bag.COMMANDED_TWIST}" in twists
    }
    return sorted(twists - limited_twists)


def _topic_of(robot: str, candidates: Sequence[str]) -> str | None:
    """Returns the ROS topic with the commanded twists of a robot.

    The name of the ROS topic contains the name of the robot.  If no topic name contains the name of
    the robot and the ROS bag contains only one twist topic, the only twist topic is returned.
    Returns ``None`` if the ROS topic cannot be determined.
    """
    robot_topic = f"/{robot}/{ros_bag.COMMANDED_TWIST}"
    if robot_topic in candidates:
        return robot_topic
    return candidates[0] if len(candidates) == 1 else None


def _list_topics(topics: Sequence[str]) -> str:
    return f"it has {', '.join(topics)}" if topics else "it has none of them"


def _commands_of_messages(
    messages: Iterable[tuple[float, Any]], timeout: float
) -> tuple[Command, ...] | None:
    """Returns the commanded twists that the messages of a ROS topic contain.

    If the ROS bag contains no message for longer than ``timeout`` (s), a command with the twist 0
    is added.  Returns ``None`` if a velocity in the ROS bag is not a number or is too large.
    """
    commands: list[Command] = []
    last_time = math.inf
    for time, message in messages:
        twist = getattr(message, "twist", message)
        command = Command(time, twist.linear.x, twist.linear.y, twist.angular.z)
        if not abs(command.vx) + abs(command.vy) + abs(command.wz) < _LARGEST:
            return None
        if time - last_time > timeout:
            _append(commands, Command(last_time + timeout, 0.0, 0.0, 0.0))
        _append(commands, command)
        last_time = time
    if math.isfinite(last_time) and math.isfinite(timeout):
        _append(commands, Command(last_time + timeout, 0.0, 0.0, 0.0))
    return tuple(commands)
