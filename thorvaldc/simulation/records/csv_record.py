"""Writes and reads the record of a run as CSV files, one file per robot.

All values in the CSV files are in SI units.  The first column of a CSV file is ``time`` (s).
Groups of the other columns:

============  ==========================================================================
``odometry``  ``odometry_x`` .. ``_yaw`` and ``odometry_vx`` .. ``_wz``: pose and twist
``truth``     ``true_*``: true pose and twist, also ``true_z``, roll and pitch
``twist``     ``asked_*``: commanded twist; ``aimed_*``: twist after limits and ramps
``joints``    the columns of ``joint_csv``, and ``<steering joint>.position_command``
============  ==========================================================================

An empty cell of a CSV file means that the value is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar, overload

from thorvaldc.compiler.recordings import csv_table
from thorvaldc.diagnostics import Report, Span, did_you_mean
from thorvaldc.diagnostics.files import AtomicFile
from thorvaldc.model import Robot, wheel_joints
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.records import joint_csv
from thorvaldc.simulation.records.recorder import RecordedRun, SampleInterval, report_missing_robot

Row = TypeVar("Row")

_TWIST = ("vx", "vy", "wz")
_POSE = ("x", "y", "yaw")
COLUMNS = {
    "odometry": tuple(f"odometry_{part}" for part in (*_POSE, *_TWIST)),
    "truth": tuple(f"true_{part}" for part in (*_POSE, *_TWIST, "z", "roll", "pitch")),
    "twist": tuple(f"{twist}_{part}" for twist in ("asked", "aimed") for part in _TWIST),
}
"""Columns of the groups that have the same columns for every robot."""
RECORDS_ARE_WRITTEN_BY = "`thorvaldc sim --record` writes records"


def columns(robot: Robot, groups: Sequence[str]) -> list[str]:
    """Returns the column names of the record of a robot."""
    names = [csv_table.TIME]
    for group, group_columns in COLUMNS.items():
        names += group_columns if group in groups else ()
    if "joints" in groups:
        drives, steering = wheel_joints(robot)
        for joint in drives:
            names += [
                joint_csv.joint_column(joint, q)
                for q in (joint_csv.POSITION, joint_csv.VELOCITY, joint_csv.COMMAND)
            ]
        for joint in steering:
            names += [
                joint_csv.joint_column(joint, q)
                for q in (joint_csv.POSITION, joint_csv.POSITION_COMMAND)
            ]
    return names


# -- writing --------------------------------------------------------------------------


class CsvRecorder:
    """Writes one CSV file per robot, with one line per sample.

    A CSV file gets its name when it is closed, also after an error of the run or Ctrl-C.  If the
    disk is full, the part that was written is kept as ``<name>.incomplete``.

    * ``path``: a folder for the files ``<robot>.csv``, or a file ``*.csv`` for a single robot.
    * ``groups``: names of the groups of columns.
    * ``every``: time between two recorded samples (s).  If ``every`` is 0, all samples are
      recorded.
    """

    def __init__(
        self,
        path: Path,
        robots: Sequence[tuple[str, Robot]],
        groups: Sequence[str],
        every: float = 0.0,
    ) -> None:
        """Creates the folder and opens the CSV files.

        Raises ``OSError`` if the folder cannot be created or a file cannot be opened.
        """
        self._groups = groups
        self._interval = SampleInterval(every)
        self._files: dict[str, AtomicFile] = {}
        self._robots = dict(robots)
        self._joints = {
            name: (list(drives.values()), list(steering.values()))
            for name, (drives, steering) in ((n, wheel_joints(robot)) for n, robot in robots)
        }
        if path.suffix == ".csv":
            self._paths = dict.fromkeys(self._robots, path)
        else:
            path.mkdir(parents=True, exist_ok=True)
            self._paths = {name: path / f"{name}.csv" for name in self._robots}
        try:
            for name, file in self._paths.items():
                self._files[name] = AtomicFile(file, keep_incomplete=True)
                self._files[name].write(",".join(columns(self._robots[name], groups)) + "\n")
                self._files[name].flush()
        except OSError:
            for opened in self._files.values():
                opened.discard()
            raise

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        if not self._interval.is_due(robot, sample.time):
            return
        values = _values(self._joints[robot], sample, commands, self._groups)
        self._files[robot].write(",".join(map(_text, values)) + "\n")

    def close(self) -> None:
        """Closes all CSV files.

        If a CSV file cannot be closed, the method closes the other CSV files and then raises the
        last ``OSError``.
        """
        last_error: OSError | None = None
        while self._files:
            try:
                self._files.popitem()[1].close()
            except OSError as error:
                last_error = error
        if last_error is not None:
            raise last_error


def _values(
    wheels: tuple[Sequence[int], Sequence[int]],
    sample: Sample,
    commands: JointCommands | None,
    groups: Sequence[str],
) -> Iterator[float]:
    """Yields the numbers of one line of the CSV file, in the order of ``columns``.

    ``wheels`` has the wheel indices of the drive joints and of the steering joints.
    """
    drives, steering = wheels
    yield sample.time
    if "odometry" in groups:
        yield from (*sample.pose_estimated, *sample.estimated)
    if "truth" in groups:
        yield from (*sample.pose_true, *sample.true, *sample.posture)
    if "twist" in groups:
        yield from (*sample.commanded, *sample.limited)
    if "joints" in groups:
        unknown = [math.nan] * (1 + max((*drives, *steering), default=0))
        joints = sample.joints or JointStates(sample.time, unknown, unknown, unknown)
        positions = joints.positions or unknown
        commanded = commands or JointCommands(unknown, unknown)
        for i in drives:
            yield from (positions[i], joints.speeds[i], commanded.speeds[i])
        for i in steering:
            yield from (joints.angles[i], commanded.angles[i])


def _text(value: float) -> str:
    """Formats a number with nine significant digits, or as an empty text if not finite.

    The text of a negative zero is ``0``, because other records do not keep the sign of a zero.
    """
    return f"{value + 0.0:.9g}" if math.isfinite(value) else ""


# -- reading --------------------------------------------------------------------------


def read_csv_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    """Returns the recorded runs by robot name.

    ``path`` is a folder of CSV files or the CSV file of one robot.  If a file is missing or
    invalid, the function adds the problems to ``report`` and returns ``None``.
    """
    display = str(path)
    files: dict[str, Path] = {}
    if path.is_dir():
        recorded = sorted(file.stem for file in path.glob("*.csv"))
        for name, _ in robots:
            if name in recorded:
                files[name] = path / f"{name}.csv"
            elif len(robots) == len(recorded) == 1:
                files[name] = path / f"{recorded[0]}.csv"
            else:
                report_missing_robot(name, recorded, display, report)
    elif len(robots) == 1:
        files = {robots[0][0]: path}
    else:
        report.add(
            "record-robot",
            f"`{display}` is the record of one robot, and there are {len(robots)}",
            Span(display),
            hint="name the folder with the records of all robots",
        )
    runs: dict[str, RecordedRun] = {}
    for name, robot in robots:
        if name in files:
            run = _read_run(files[name], robot, report)
            if run is not None:
                runs[name] = run
    return runs if len(runs) == len(robots) else None


def _read_run(path: Path, robot: Robot, report: Report) -> RecordedRun | None:
    display = str(path)
    table = csv_table.read_table(path, display, report)
    if table is None:
        return None
    groups = tuple(g for g in GROUPS if any(c in table.columns for c in columns(robot, [g])[1:]))
    if not groups:
        report.add(
            "record-unreadable",
            f"`{display}` is not a record: a record has no column "
            f"`{next(c for c in table.columns if c != csv_table.TIME)}`",
            Span(display, 1, 1, 1, 1),
            hint=RECORDS_ARE_WRITTEN_BY,
        )
        return None
    if not _columns_match(table, robot, groups, report):
        return None
    has_joints = "joints" in groups
    return RecordedRun(
        groups,
        _Rows(table, lambda cells: sample_of(cells, robot, has_joints)),
        _Rows(table, lambda cells: commands_of(cells, robot) if has_joints else None),
    )


class _Rows(Sequence[Row]):
    """The rows of a table, each made from its cells when it is read.

    A sample takes 1 to 2 kB, and a long record has a million of them; the table has 8 bytes for
    each number.
    """

    def __init__(self, table: csv_table.Table, make: Callable[[Mapping[str, float]], Row]) -> None:
        self._table = table
        self._make = make

    def __len__(self) -> int:
        return len(self._table)

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> list[Row]: ...
    def __getitem__(self, index: int | slice) -> Row | list[Row]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        return self._make({name: column[index] for name, column in self._table.columns.items()})


def _columns_match(
    table: csv_table.Table, robot: Robot, groups: Sequence[str], report: Report
) -> bool:
    """Checks that a CSV file has exactly the columns of the recorded groups of a robot."""
    known = columns(robot, GROUPS)
    unknown = next((column for column in table.columns if column not in known), None)
    missing = next((c for c in columns(robot, groups) if c not in table.columns), None)
    other_robot = "is it the record of another robot?"
    if unknown is not None:
        report.add(
            "record-robot",
            f"the record of {robot.name} has a column `{unknown}`",
            table.span_of(unknown),
            hint=did_you_mean(unknown, known, other_robot, fixable=False),
        )
    elif missing is not None and groups == ("joints",):
        report.add(
            "record-unreadable",
            f"`{table.display}` is a joint log and not a record: it has no column `{missing}`",
            Span(table.display, 1, 1, 1, 1),
            hint=RECORDS_ARE_WRITTEN_BY,
        )
    elif missing is not None:
        report.add(
            "record-robot",
            f"the record of {robot.name} has no column `{missing}`",
            Span(table.display, 1, 1, 1, 1),
            hint=other_robot,
        )
    return unknown is missing is None


def sample_of(cells: Mapping[str, float], robot: Robot, has_joints: bool) -> Sample:
    """Returns the sample of a record from its values by column; others are unknown."""

    def twist(name: str) -> Twist:
        return Twist(*(cells.get(f"{name}_{part}", math.nan) for part in _TWIST))

    def pose(name: str) -> Pose2:
        return Pose2(*(cells.get(f"{name}_{part}", math.nan) for part in _POSE))

    time = cells[csv_table.TIME]
    joints = None
    if has_joints:
        joints = JointStates(
            time,
            _drives(cells, robot, joint_csv.VELOCITY),
            _steering(cells, robot, joint_csv.POSITION),
            _steering(cells, robot, joint_csv.VELOCITY),
            _drives(cells, robot, joint_csv.POSITION),
        )
    z, roll, pitch = (cells.get(f"true_{part}", math.nan) for part in ("z", "roll", "pitch"))
    return Sample(
        time,
        twist("asked"),
        twist("aimed"),
        twist("odometry"),
        twist("true"),
        pose("odometry"),
        pose("true"),
        joints,
        (z, roll, pitch),
    )


def commands_of(cells: Mapping[str, float], robot: Robot) -> JointCommands:
    """Returns the joint commands of a record from its values by column."""
    return JointCommands(
        _drives(cells, robot, joint_csv.COMMAND),
        _steering(cells, robot, joint_csv.POSITION_COMMAND),
    )


def _drives(cells: Mapping[str, float], robot: Robot, quantity: str) -> list[float]:
    joints = (wheel.spin_joint if wheel.driven else "" for wheel in robot.wheels)
    return [cells.get(joint_csv.joint_column(joint, quantity), 0.0) for joint in joints]


def _steering(cells: Mapping[str, float], robot: Robot, quantity: str) -> list[float]:
    joints = (wheel.steering_joint or "" for wheel in robot.wheels)
    return [cells.get(joint_csv.joint_column(joint, quantity), 0.0) for joint in joints]
