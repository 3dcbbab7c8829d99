"""Writes and reads joint logs: CSV files of encoder readings for the command ``calibrate``.

The first line of a joint log contains the column names.  The first column of a joint log is
``time`` (s), and the other column names are ``<joint>.<quantity>``.  Each further line of a joint
log has the encoder readings of one tick of the driver.

===============  =====================================================================
drive joint      ``position`` (rad, not wrapped) or ``velocity`` (rad/s); optionally
                 ``velocity_command`` (rad/s), which the motor gets until the next line
steering joint   ``position`` (rad)
===============  =====================================================================

The values in a joint log are raw encoder readings without the steering offsets of a calibration.
The reader does not accept empty cells or incomplete lines, because a calibration requires complete
data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.compiler.recordings.csv_table import (
    TIME,
    RowRules,
    cell_span,
    column_names,
    first_line,
    read_columns,
    read_utf8,
)
from thorvaldc.diagnostics import Report, Span, did_you_mean
from thorvaldc.model import Robot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.odometry import LONGEST_INTERVAL

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    from thorvaldc.simulation.control_loop import ControlLoop

POSITION, VELOCITY, COMMAND = "position", "velocity", "velocity_command"
_ROW_RULES = RowRules(
    "joint-log-value",
    "joint-log-time",
    "times must increase; write each run to a file of its own",
    complete=True,
)


@dataclass(frozen=True, slots=True)
class _Joint:
    """A joint with an encoder, the index of the first wheel on the joint, and the encoder offset.

    The encoder offset of the joint is in rad.
    """

    name: str
    wheel: int
    offset: float = 0.0


def drive_joints(robot: Robot) -> list[_Joint]:
    """Returns the spin joints that have a motor with an encoder, without duplicates."""
    joints: dict[str, _Joint] = {}
    for i, wheel in enumerate(robot.wheels):
        if robot.actuator_of(wheel.spin_joint) is not None:
            joints.setdefault(wheel.spin_joint, _Joint(wheel.spin_joint, i))
    return list(joints.values())


def steering_joints(robot: Robot) -> list[_Joint]:
    """Returns the steering joints that have a motor, without duplicates."""
    joints: dict[str, _Joint] = {}
    for i, wheel in enumerate(robot.wheels):
        name = wheel.steering_joint
        motor = robot.actuator_of(name) if name is not None else None
        if name is not None and motor is not None:
            joints.setdefault(name, _Joint(name, i, motor.encoder_offset))
    return list(joints.values())


class JointLogWriter:
    """Writes the joint states of each tick of the driver to a text stream."""

    def __init__(self, robot: Robot, stream: SupportsWrite[str]) -> None:
        self._stream = stream
        self._drives = drive_joints(robot)
        self._steering = steering_joints(robot)
        self._time = -math.inf
        self._quantities: tuple[str, ...] = ()

    def record(self, state: DriverState) -> None:
        """Writes the joint states of a tick as one line of the joint log.

        Joint states that are missing, faulty or repeated are not written.
        """
        joints, command = state.joints, state.command
        if joints is None or command is None or state.fault or not joints.time > self._time:
            return
        positions = joints.positions
        if not self._quantities:
            position = (POSITION,) if positions is not None else ()
            self._quantities = (*position, VELOCITY, COMMAND)
            self._write_header()
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
        """Writes the joint states after a tick of a simulation (a ``TickCallback``)."""
        self.record(loop.driver.state)

    def _write_header(self) -> None:
        columns = [TIME]
        for joint in self._drives:
            columns += [f"{joint.name}.{quantity}" for quantity in self._quantities]
        columns += [f"{joint.name}.{POSITION}" for joint in self._steering]
        self._stream.write(",".join(columns) + "\n")


def _text(value: float) -> str:
    return f"{value:.10g}"


@dataclass(frozen=True, slots=True)
class JointLog:
    """The columns of a joint log by joint name, in the order of the joints of the robot.

    * ``positions``: positions of the drive joints (rad).
    * ``velocities``: velocities (rad/s) of the drive joints that are not in ``positions``.
    * ``commands``: commanded velocities of the drive joints (rad/s), if the log has commands.
    * ``angles``: positions of the steering joints (rad).
    """

    times: Sequence[float]
    positions: dict[str, Sequence[float]]
    velocities: dict[str, Sequence[float]]
    commands: dict[str, Sequence[float]]
    angles: dict[str, Sequence[float]]


def read_log(path: Path, display: str, robot: Robot, report: Report) -> JointLog | None:
    """Reads the joint log of a robot.

    If the joint log is invalid, the function adds the problems with line and column to ``report``
    and returns ``None``.  ``display`` is the name of the file for the diagnostics.
    """
    data = read_utf8(path, display, report)
    if data is None:
        return None
    header = _header(first_line(data), display, report)
    if header is None or not _joints_match(header, display, robot, report):
        return None
    columns = read_columns(data, header, display, report, _ROW_RULES)
    if columns is None:
        return None
    times = columns[TIME]
    _report_gaps(times, display, report)
    positions: dict[str, Sequence[float]] = {}
    velocities: dict[str, Sequence[float]] = {}
    commands: dict[str, Sequence[float]] = {}
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
    """Returns the column names, or ``None`` if the file is not a joint log."""
    names = column_names(line)
    for i, name in enumerate(names):
        span = cell_span(display, 1, line, i)
        joint, _, quantity = name.rpartition(".")
        if name in names[:i]:
            report.add("joint-log-header", f"two columns have the name `{name}`", span)
        elif name != TIME and not (joint and quantity in (POSITION, VELOCITY, COMMAND)):
            report.add(
                "joint-log-header",
                f"a joint log has no column `{name}`",
                span,
                hint="a column is `time`, or a joint and a quantity, such as "
                "fl_drive_axle.position; quantities are position, velocity, velocity_command",
            )
        else:
            continue
        return None  # after one unknown column, this is probably another kind of file
    if TIME not in names:
        report.add("joint-log-header", "the log has no column `time`", Span(display, 1, 1, 1, 1))
        return None
    return names


def _joints_match(header: Sequence[str], display: str, robot: Robot, report: Report) -> bool:
    """Checks that the joints of a joint log are the joints of the robot.

    A joint log must contain all joints with a motor, and no joint of another robot.
    """
    line = ",".join(header)
    known = {joint.name for joint in robot.joints}
    logged = list(dict.fromkeys(name.rpartition(".")[0] for name in header if name != TIME))
    drives, steering = drive_joints(robot), steering_joints(robot)
    needed = [joint.name for joint in (*drives, *steering)]
    if logged and not known.intersection(logged):
        report.add(
            "joint-log-joint",
            f"{robot.name} has none of the {len(logged)} joints in the log",
            cell_span(display, 1, line, 1),
            hint=f"is it the log of another robot? {robot.name} has {', '.join(needed[:3])} ..",
        )
        return False
    matches = True
    for joint in logged:
        if joint not in known:
            first = next(i for i, name in enumerate(header) if name.startswith(f"{joint}."))
            report.add(
                "joint-log-joint",
                f"{robot.name} has no joint `{joint}`",
                cell_span(display, 1, line, first),
                hint=did_you_mean(joint, needed, "is it the log of another robot?", fixable=False),
            )
            matches = False
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
            matches = False
    return matches


def _report_gaps(times: Sequence[float], display: str, report: Report) -> None:
    gaps = [(a, b) for a, b in pairwise(times) if b - a > LONGEST_INTERVAL]
    if gaps:
        a, b = max(gaps, key=lambda gap: gap[1] - gap[0])
        report.add(
            "joint-log-gap",
            f"the log has {len(gaps)} gap{'s' if len(gaps) > 1 else ''} of more than "
            f"{LONGEST_INTERVAL:g} s, the longest from {a:.6g} s to {b:.6g} s",
            Span(display, 1, 1, 1, 1),
            hint="the motion in a gap is ignored",
        )
