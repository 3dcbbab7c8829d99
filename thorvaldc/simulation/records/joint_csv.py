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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.compiler.recordings import csv_table
from thorvaldc.diagnostics import Report, Span, did_you_mean
from thorvaldc.model import Robot, wheel_joints
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.odometry import LONGEST_INTERVAL

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    from thorvaldc.simulation.control_loop import ControlLoop

POSITION, VELOCITY, COMMAND = "position", "velocity", "velocity_command"
POSITION_COMMAND = "position_command"
"""Quantities of a joint; a joint log has no commanded positions, the record of a run has."""


def joint_column(joint: str, quantity: str) -> str:
    """Returns the column of a joint in a joint log or in the CSV record of a run."""
    return f"{joint}.{quantity}"


@dataclass(frozen=True, slots=True)
class _Joint:
    """A joint with an encoder, the index of the first wheel on the joint, and the encoder offset.

    The encoder offset of the joint is in rad.
    """

    name: str
    wheel: int
    offset: float = 0.0


def _joints(robot: Robot) -> tuple[list[_Joint], list[_Joint]]:
    """Returns the drive joints and the steering joints of a robot."""
    drives, steering = wheel_joints(robot)
    motors = {name: robot.actuator_of(name) for name in steering}
    return [_Joint(name, wheel) for name, wheel in drives.items()], [
        _Joint(name, steering[name], motor.encoder_offset if motor is not None else 0.0)
        for name, motor in motors.items()
    ]


class JointLogWriter:
    """Writes the joint states of each tick of the driver to a text stream."""

    def __init__(self, robot: Robot, stream: SupportsWrite[str]) -> None:
        self._stream = stream
        self._drives, self._steering = _joints(robot)
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
        columns = [csv_table.TIME]
        for joint in self._drives:
            columns += [joint_column(joint.name, quantity) for quantity in self._quantities]
        columns += [joint_column(joint.name, POSITION) for joint in self._steering]
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
    header = csv_table.read_header(path, display, report)
    if header is None or not _joints_match(header, robot, report):
        return None
    columns = csv_table.read_columns(header, report, complete=True)
    if columns is None:
        return None
    times = columns[csv_table.TIME]
    _report_gaps(times, display, report)
    drives, steering = wheel_joints(robot)

    def of(joints: Iterable[str], quantity: str) -> dict[str, Sequence[float]]:
        return {
            name: columns[joint_column(name, quantity)]
            for name in joints
            if joint_column(name, quantity) in columns
        }

    positions = of(drives, POSITION)
    velocities = of([name for name in drives if name not in positions], VELOCITY)
    return JointLog(times, positions, velocities, of(drives, COMMAND), of(steering, POSITION))


def _joints_match(header: csv_table.Header, robot: Robot, report: Report) -> bool:
    """Checks that the columns of a joint log are those of the joints of the robot.

    A joint log must contain all joints with a motor, and no joint of another robot.
    """
    known = {joint.name for joint in robot.joints}
    logged: dict[str, str] = {}  # the first column of each joint
    for column in header.names:
        joint, _, quantity = column.rpartition(".")
        if joint and quantity in (POSITION, VELOCITY, COMMAND):
            logged.setdefault(joint, column)
        elif column != csv_table.TIME:
            report.add(
                "joint-log-joint",
                f"a joint log has no column `{column}`",
                header.span_of(column),
                hint="a column is `time`, or a joint and a quantity, such as "
                "fl_drive_axle.position; quantities are position, velocity, velocity_command",
            )
            return False  # this is probably another kind of file
    drives, steering = wheel_joints(robot)
    needed = [*drives, *steering]
    if not known.intersection(logged):
        report.add(
            "joint-log-joint",
            f"{robot.name} has none of the {len(logged)} joints in the log",
            header.span_of(next(iter(logged.values()))),
            hint=f"is it the log of another robot? {robot.name} has {', '.join(needed[:3])} ..",
        )
        return False
    matches = True
    for joint, column in logged.items():
        if joint not in known:
            report.add(
                "joint-log-joint",
                f"{robot.name} has no joint `{joint}`",
                header.span_of(column),
                hint=did_you_mean(joint, needed, "is it the log of another robot?", fixable=False),
            )
            matches = False
    for name, quantities in (
        *((name, (POSITION, VELOCITY)) for name in drives),
        *((name, (POSITION,)) for name in steering),
    ):
        if not any(joint_column(name, quantity) in header.names for quantity in quantities):
            report.add(
                "joint-log-joint",
                f"the log has no {' and no '.join(quantities)} of the joint `{name}`",
                header.span,
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
