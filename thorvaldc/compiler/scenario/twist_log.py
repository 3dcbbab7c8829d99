"""Velocities that were recorded, as the script of a scenario: from CSV files and bags of ROS."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.csv_table import TIME, Table, read_table
from thorvaldc.compiler.source.ros_bag import (
    COMMANDED_TWIST,
    LIMITED_TWIST,
    MissingPackageError,
    is_bag,
    read_bag,
)
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.scenario import Command

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
_PARTS = ("vx", "vy", "wz")
_BEYOND = 1e9
"""Velocity (m/s, rad/s) that nobody can have meant."""


def read_twists(
    path: Path,
    display: str,
    span: Span,
    robots: Sequence[tuple[str, Robot]],
    topic: str,
    files: dict[str, Path],
    report: Report,
) -> dict[str, tuple[Command, ...]]:
    """The commands of each robot by its name; times count from the beginning of the log.

    ``path`` is a record, a bag or a CSV file; ``display`` is what it is called in
    diagnostics, ``span`` where it is named.  ``topic`` may name one of a bag's.  Files that were
    read go to ``files`` by their names in spans, what is wrong to ``report``.
    """
    if not path.exists():
        report.add("script-log", f"there is no file `{display}`", span)
        return {}
    if is_bag(path):
        inner = sorted(path.iterdir()) if path.is_dir() else [path]
        files.update((f"{display}/{f.name}" if path.is_dir() else display, f) for f in inner)
        return _of_bag(path, display, span, robots, topic, report)
    if topic:
        report.add("script-log", f"`{display}` is no bag of ROS: it has no topics", span)
        return {}
    found: dict[str, tuple[Command, ...]] = {}
    for name, _ in robots:
        file, shown = path, display
        if path.is_dir():
            file, shown = path / f"{name}.csv", f"{display}/{name}.csv"
            if not file.is_file():
                message = f"`{display}` has no file {name}.csv, for {name}"
                report.add("script-log", message, span)
                continue
        files[shown] = file
        table = read_table(file, shown, report)
        if table is not None:
            commands = _of_table(table, report)
            if commands is not None:
                found[name] = commands
        if not path.is_dir():
            return {each: found.get(name, ()) for each, _ in robots}
    return found


def _of_table(table: Table, report: Report) -> tuple[Command, ...] | None:
    columns = table.columns
    prefix = "asked_" if "asked_vx" in columns else ""
    named = [prefix + part for part in _PARTS]
    if not any(name in columns for name in named):
        report.add(
            "script-log",
            f"`{table.display}` has no velocities: no column `asked_vx` of a record, nor `vx`, "
            "`vy` or `wz`",
            Span(table.display, 1, 1, 1, 1),
        )
        return None
    rows = zip(
        columns[TIME],
        *(columns.get(name, [0.0] * len(table)) for name in named),
        strict=True,
    )
    commands: list[Command] = []
    for row in rows:
        if not all(map(math.isfinite, row)):
            report.add(
                "script-log",
                f"`{table.display}` has no velocity at {row[0]:.6g} s",
                Span(table.display, 1, 1, 1, 1),
            )
            return None
        _append(commands, Command(*row))
    return tuple(commands)


def _append(commands: list[Command], command: Command) -> None:
    """Add it, unless it says what the last one said."""
    last = commands[-1] if commands else Command(0.0, 0.0, 0.0, 0.0)
    if (command.vx, command.vy, command.wz) != (last.vx, last.vy, last.wz):
        commands.append(command)


# -- bags -----------------------------------------------------------------------------


def _of_bag(
    path: Path,
    display: str,
    span: Span,
    robots: Sequence[tuple[str, Robot]],
    topic: str,
    report: Report,
) -> dict[str, tuple[Command, ...]]:
    def choose(topics: Mapping[str, str]) -> list[str]:
        return _with_twists(topics) if not topic else [topic] if topic in topics else []

    try:
        bag = read_bag(path, display, span, choose, report)
    except MissingPackageError as fault:
        report.add("script-log", str(fault), span)
        return {}
    if bag is None:
        return {}
    candidates = _with_twists(bag.topics)
    if topic and topic not in candidates:
        said = f"is of the type {bag.topics[topic]}" if topic in bag.topics else "is not there"
        report.add(
            "script-log",
            f"the topic `{topic}` of `{display}` {said}; a Twist or TwistStamped is wanted",
            span,
            hint=did_you_mean(topic, candidates, _listed(candidates)),
        )
        return {}
    found: dict[str, tuple[Command, ...]] = {}
    for name, robot in robots:
        own = topic or _topic_of(name, candidates)
        if own is None:
            report.add(
                "script-log",
                f"`{display}` has "
                + (f"{len(candidates)} topics" if candidates else "no topic")
                + f" with velocities, and none is `/{name}/{COMMANDED_TWIST}`",
                span,
                hint=f"add `topic:`; {_listed(candidates)}" if candidates else None,
            )
            continue
        # In our records a velocity holds until the next; of a robot, for its time-out.
        ours = f"{own.removesuffix(COMMANDED_TWIST)}{LIMITED_TWIST}" in bag.topics
        timeout = math.inf if ours else robot.driver.command_timeout
        commands = _commands(bag.messages[own], timeout)
        if commands is None:
            report.add("script-log", f"`{own}` of `{display}` has a velocity beyond reason", span)
            continue
        found[name] = commands
    return found


def _with_twists(topics: Mapping[str, str]) -> list[str]:
    """The topics with velocities that were asked for, in order of their names."""
    found = {name for name, type_ in topics.items() if type_ in (TWIST, TWIST_STAMPED)}
    limited = {name for name in found if name.endswith(f"/{LIMITED_TWIST}")}
    return sorted(
        found - {n for n in limited if f"{n.removesuffix(LIMITED_TWIST)}{COMMANDED_TWIST}" in found}
    )


def _topic_of(robot: str, candidates: Sequence[str]) -> str | None:
    own = f"/{robot}/{COMMANDED_TWIST}"
    if own in candidates:
        return own
    return candidates[0] if len(candidates) == 1 else None


def _listed(topics: Sequence[str]) -> str:
    return f"it has {', '.join(topics)}" if topics else "it has none of them"


def _commands(messages: Iterable[tuple[float, Any]], timeout: float) -> tuple[Command, ...] | None:
    """``None`` where a velocity is no number or beyond all bounds."""
    commands: list[Command] = []
    before = math.inf
    for time, message in messages:
        twist = getattr(message, "twist", message)
        command = Command(time, twist.linear.x, twist.linear.y, twist.angular.z)
        if not abs(command.vx) + abs(command.vy) + abs(command.wz) < _BEYOND:
            return None
        if time - before > timeout:
            _append(commands, Command(before + timeout, 0.0, 0.0, 0.0))
        _append(commands, command)
        before = time
    if math.isfinite(before) and math.isfinite(timeout):
        _append(commands, Command(before + timeout, 0.0, 0.0, 0.0))
    return tuple(commands)
