"""Recorded joint states as a plain CSV file: written while driving, read back strictly.

The first line names the columns: ``time`` (s), then ``<joint>.<quantity>``.  Of a
driven wheel's joint ``position`` (rad, not wrapped) or ``velocity`` (rad/s), and
if it was recorded ``velocity_command`` (rad/s, what its motor was asked for from
then on); of a steering joint ``position`` (rad).  All are encoders' readings: the
steering offsets of a calibration are not applied.  One line per tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from thorvaldc.compiler.source.csv_table import cell_span, parse_number, read_utf8
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.odometry import LONGEST_INTERVAL

if TYPE_CHECKING:
    from thorvaldc.simulation.control_loop import ControlLoop

TIME = "time"
POSITION, VELOCITY, COMMAND = "position", "velocity", "velocity_command"
_MOST_FAULTS = 10
"""Faults of values that are told before reading ends."""


@dataclass(frozen=True, slots=True)
class _Joint:
    """A joint with an encoder and the index of (the first of) its wheels."""

    name: str
    wheel: int
    offset: float = 0.0


def drive_joints(robot: Robot) -> list[_Joint]:
    """The joints whose turning a motor's encoder tells, each once."""
    found: dict[str, _Joint] = {}
    for i, wheel in enumerate(robot.wheels):
        if robot.actuator_of(wheel.spin_joint) is not None:
            found.setdefault(wheel.spin_joint, _Joint(wheel.spin_joint, i))
    return list(found.values())


def steering_joints(robot: Robot) -> list[_Joint]:
    """The joints that a motor steers, each once."""
    found: dict[str, _Joint] = {}
    for i, wheel in enumerate(robot.wheels):
        name = wheel.steering_joint
        motor = robot.actuator_of(name) if name is not None else None
        if name is not None and motor is not None:
            found.setdefault(name, _Joint(name, i, motor.encoder_offset))
    return list(found.values())


class JointLogWriter:
    """Writes the joints of a robot's ticks to a stream, line by line."""

    def __init__(self, robot: Robot, stream: TextIO) -> None:
        self._stream = stream
        self._drives = drive_joints(robot)
        self._steering = steering_joints(robot)
        self._time = -math.inf
        self._quantities: tuple[str, ...] = ()

    def record(self, state: DriverState) -> None:
        """A line for the tick; none where its joints could not be used."""
        joints, command = state.joints, state.command
        if joints is None or command is None or state.fault or not joints.time > self._time:
            return
        positions = joints.positions
        if not self._quantities:
            counted = (POSITION,) if positions is not None else ()
            self._quantities = (*counted, VELOCITY, COMMAND)
            self._head()
        self._time = joints.time
        cells = [_text(joints.time)]
        for joint in self._drives:
            i = joint.wheel
            if positions is not None:
                cells.append(_text(positions[i]))
            cells += [_text(joints.speeds[i]), _text(command.joints.speeds[i])]
        cells += [_text(joints.angles[j.wheel] - j.offset) for j in self._steering]
        self._stream.write(",".join(cells) + "\n")

    def on_tick(self, loop: ControlLoop) -> None:
        """``record``, for ``Simulation.run``."""
        self.record(loop.driver.state)

    def _head(self) -> None:
        columns = [TIME]
        for joint in self._drives:
            columns += [f"{joint.name}.{quantity}" for quantity in self._quantities]
        columns += [f"{joint.name}.{POSITION}" for joint in self._steering]
        self._stream.write(",".join(columns) + "\n")


def _text(value: float) -> str:
    return f"{value:.10g}"


@dataclass(frozen=True, slots=True)
class JointLog:
    """A log as columns; joints in the order of the robot's, each once.

    Per drive joint ``positions`` or ``velocities`` (the other is empty), and
    ``commands`` where they were recorded; per steering joint its ``angles``.
    """

    times: list[float]
    positions: dict[str, list[float]]
    velocities: dict[str, list[float]]
    commands: dict[str, list[float]]
    angles: dict[str, list[float]]


def read_log(path: Path, display: str, robot: Robot, report: Report) -> JointLog | None:
    """The log of ``robot`` in a file called ``display``; ``None`` where it is none.

    All that is wrong with it goes to ``report``, with the line and column.
    """
    text = read_utf8(path, display, report)
    if text is None:
        return None
    lines = text.split("\n")
    header = _header(lines[0].rstrip("\r"), display, report)
    if header is None or not _joints_fit(header, display, robot, report):
        return None
    columns = _values(lines, header, display, report)
    if columns is None:
        return None
    times = columns[TIME]
    _tell_gaps(times, display, report)
    positions: dict[str, list[float]] = {}
    velocities: dict[str, list[float]] = {}
    commands: dict[str, list[float]] = {}
    for joint in drive_joints(robot):
        if f"{joint.name}.{POSITION}" in columns:
            positions[joint.name] = columns[f"{joint.name}.{POSITION}"]
        else:
            velocities[joint.name] = columns[f"{joint.name}.{VELOCITY}"]
        if f"{joint.name}.{COMMAND}" in columns:
            commands[joint.name] = columns[f"{joint.name}.{COMMAND}"]
    angles = {j.name: columns[f"{j.name}.{POSITION}"] for j in steering_joints(robot)}
    return JointLog(times, positions, velocities, commands, angles)


def _header(line: str, display: str, report: Report) -> list[str] | None:
    names = [name.strip() for name in line.split(",")]
    wrong = False
    for i, name in enumerate(names):
        span = cell_span(display, 1, line, i)
        joint, _, quantity = name.rpartition(".")
        if name in names[:i]:
            report.add("joint-log-header", f"two columns are called `{name}`", span)
        elif name != TIME and not (joint and quantity in (POSITION, VELOCITY, COMMAND)):
            report.add(
                "joint-log-header",
                f"`{name}` is no column of a joint log",
                span,
                hint="a column is called `time` or by a joint and a quantity, such as "
                "fl_drive_axle.position; quantities are position, velocity, velocity_command",
            )
        else:
            continue
        wrong = True
        break  # one is enough: the file is none of ours
    if not wrong and TIME not in names:
        report.add("joint-log-header", "the log has no column `time`", Span(display, 1, 1, 1, 1))
        wrong = True
    return None if wrong else names


def _joints_fit(header: Sequence[str], display: str, robot: Robot, report: Report) -> bool:
    """Whether the log has all joints of the robot that are needed, and no others."""
    line = ",".join(header)
    known = {joint.name for joint in robot.joints}
    logged = list(dict.fromkeys(name.rpartition(".")[0] for name in header if name != TIME))
    drives, steering = drive_joints(robot), steering_joints(robot)
    needed = [joint.name for joint in (*drives, *steering)]
    if logged and not known.intersection(logged):
        report.add(
            "joint-log-joint",
            f"none of the log's {len(logged)} joints is a joint of {robot.name}",
            cell_span(display, 1, line, 1),
            hint=f"is it the log of another robot? {robot.name} has {', '.join(needed[:3])} ..",
        )
        return False
    fits = True
    for joint in logged:
        if joint not in known:
            first = next(i for i, name in enumerate(header) if name.startswith(f"{joint}."))
            report.add(
                "joint-log-joint",
                f"{robot.name} has no joint `{joint}`",
                cell_span(display, 1, line, first),
                hint=did_you_mean(joint, needed, "is it the log of another robot?"),
            )
            fits = False
    for name, quantities in (
        *((joint.name, (POSITION, VELOCITY)) for joint in drives),
        *((joint.name, (POSITION,)) for joint in steering),
    ):
        if not any(f"{name}.{quantity}" in header for quantity in quantities):
            report.add(
                "joint-log-joint",
                f"the log has no {' and no '.join(quantities)} of the joint `{name}`",
                Span(display, 1, 1, 1, 1),
                hint="record every joint that has a motor",
            )
            fits = False
    return fits


def _values(
    lines: Sequence[str], header: Sequence[str], display: str, report: Report
) -> dict[str, list[float]] | None:
    rows: list[list[float]] = []
    faults = 0
    before = -math.inf
    clock = list(header).index(TIME)
    for count, raw in enumerate(lines[1:], start=2):
        line = raw.rstrip("\r")
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(header):
            report.add(
                "joint-log-value",
                f"the line has {len(cells)} values; the header has {len(header)} columns",
                Span(display, count, 1, count, len(line) + 1),
            )
            faults += 1
        else:
            row = [parse_number(cell) for cell in cells]
            bad = next((i for i, value in enumerate(row) if not math.isfinite(value)), None)
            if bad is not None:
                report.add(
                    "joint-log-value",
                    f"`{cells[bad].strip()}` in column {header[bad]} is not a finite number",
                    cell_span(display, count, line, bad),
                )
                faults += 1
            elif not row[clock] > before:
                report.add(
                    "joint-log-time",
                    f"the time goes from {before:.10g} s to {row[clock]:.10g} s",
                    cell_span(display, count, line, clock),
                    hint="a log is of one run, in order of time; split runs into files",
                )
                faults += 1
            else:
                before = row[clock]
                rows.append(row)
        if faults >= _MOST_FAULTS:
            break
    if faults:
        return None
    return {name: [row[i] for row in rows] for i, name in enumerate(header)}


def _tell_gaps(times: Sequence[float], display: str, report: Report) -> None:
    gaps = [(a, b) for a, b in pairwise(times) if b - a > LONGEST_INTERVAL]
    if gaps:
        a, b = max(gaps, key=lambda gap: gap[1] - gap[0])
        report.add(
            "joint-log-gap",
            f"the log has {len(gaps)} gap{'s' if len(gaps) > 1 else ''} of more than "
            f"{LONGEST_INTERVAL:g} s, the longest from {a:.6g} s to {b:.6g} s",
            Span(display, 1, 1, 1, 1),
            hint="what the robot did in between is left out",
        )
