"""Writes and reads the record of a run as CSV files, one file per robot.

All values in the CSV files are in SI units.  The first column of a CSV file is ``time`` (s).
Groups of the other columns:

============  ==========================================================================
``odometry``  ``odometry_x`` .. ``_yaw`` and ``odometry_vx`` .. ``_wz``: pose and twist
``truth``     ``true_*``: true pose and twist, also ``true_z``, roll and pitch
``twist``     ``asked_*``: commanded twist; ``aimed_*``: twist after limits and ramps
``joints``    ``<joint>_position``, ``_velocity`` and ``_command``
============  ==========================================================================

An empty cell of a CSV file means that the value is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from thorvaldc.compiler.recordings.csv_table import TIME, Table, read_table
from thorvaldc.diagnostics import Report, Span, did_you_mean
from thorvaldc.diagnostics.atomic_file import AtomicFile
from thorvaldc.model import Robot
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.records.recorder import RecordedRun, SampleInterval, report_missing_robot

_TWIST = ("vx", "vy", "wz")
_POSE = ("x", "y", "yaw")
_POSTURE = ("z", "roll", "pitch")


def columns(robot: Robot, groups: Sequence[str]) -> list[str]:
    """Returns the column names of the record of a robot."""
    names = [TIME]
    if "odometry" in groups:
        names += [f"odometry_{part}" for part in (*_POSE, *_TWIST)]
    if "truth" in groups:
        names += [f"true_{part}" for part in (*_POSE, *_TWIST, *_POSTURE)]
    if "twist" in groups:
        names += [f"{twist}_{part}" for twist in ("asked", "aimed") for part in _TWIST]
    if "joints" in groups:
        for wheel in robot.wheels:
            if wheel.driven:
                joint = wheel.spin_joint
                names += [f"{joint}_position", f"{joint}_velocity", f"{joint}_command"]
            if wheel.steering_joint is not None:
                names += [f"{wheel.steering_joint}_position", f"{wheel.steering_joint}_command"]
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
        values = _values(self._robots[robot], sample, commands, self._groups)
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
    robot: Robot, sample: Sample, commands: JointCommands | None, groups: Sequence[str]
) -> Iterator[float]:
    """Yields the numbers of one line of the CSV file, in the order of ``columns``."""
    yield sample.time
    if "odometry" in groups:
        yield from sample.pose_estimated
        yield from sample.estimated
    if "truth" in groups:
        yield from sample.pose_true
        yield from sample.true
        yield from sample.posture
    if "twist" in groups:
        yield from sample.commanded
        yield from sample.limited
    if "joints" in groups:
        joints, unknown = sample.joints, [math.nan] * len(robot.wheels)
        positions = (joints.positions if joints is not None else None) or unknown
        speeds, angles = (
            (joints.speeds, joints.angles) if joints is not None else (unknown, unknown)
        )
        for i, wheel in enumerate(robot.wheels):
            if wheel.driven:
                yield positions[i]
                yield speeds[i]
                yield commands.speeds[i] if commands is not None else math.nan
            if wheel.steered:
                yield angles[i]
                yield commands.angles[i] if commands is not None else math.nan


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
    table = read_table(path, display, report)
    if table is None:
        return None
    groups = tuple(g for g in GROUPS if any(c in table.columns for c in columns(robot, [g])[1:]))
    if not groups:
        report.add(
            "record-unreadable",
            f"`{display}` is not a record: a record has no column "
            f"`{next(c for c in table.columns if c != TIME)}`",
            Span(display, 1, 1, 1, 1),
            hint="`thorvaldc sim --record` writes records",
        )
        return None
    if not _columns_match(table, robot, groups, report):
        return None
    run = RecordedRun(groups, [], [])
    for row in range(len(table)):

        def cell(name: str, row: int = row) -> float:
            column = table.columns.get(name)
            return column[row] if column is not None else math.nan

        run.samples.append(_sample(cell, robot, "joints" in groups))
        run.commands.append(_commands(cell, robot) if "joints" in groups else None)
    return run


def _columns_match(table: Table, robot: Robot, groups: Sequence[str], report: Report) -> bool:
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
    elif missing is not None:
        report.add(
            "record-robot",
            f"the record of {robot.name} has no column `{missing}`",
            Span(table.display, 1, 1, 1, 1),
            hint=other_robot,
        )
    return unknown is missing is None


def _sample(cell: Callable[[str], float], robot: Robot, has_joints: bool) -> Sample:
    def twist(name: str) -> Twist:
        return Twist(cell(f"{name}_vx"), cell(f"{name}_vy"), cell(f"{name}_wz"))

    def pose(name: str) -> Pose2:
        return Pose2(cell(f"{name}_x"), cell(f"{name}_y"), cell(f"{name}_yaw"))

    joints = None
    if has_joints:
        wheels = robot.wheels
        joints = JointStates(
            cell(TIME),
            [cell(f"{w.spin_joint}_velocity") if w.driven else 0.0 for w in wheels],
            [cell(f"{w.steering_joint}_position") if w.steered else 0.0 for w in wheels],
            [0.0] * len(wheels),
            [cell(f"{w.spin_joint}_position") if w.driven else 0.0 for w in wheels],
        )
    return Sample(
        cell(TIME),
        twist("asked"),
        twist("aimed"),
        twist("odometry"),
        twist("true"),
        pose("odometry"),
        pose("true"),
        joints,
        (cell("true_z"), cell("true_roll"), cell("true_pitch")),
    )


def _commands(cell: Callable[[str], float], robot: Robot) -> JointCommands:
    return JointCommands(
        [cell(f"{w.spin_joint}_command") if w.driven else 0.0 for w in robot.wheels],
        [cell(f"{w.steering_joint}_command") if w.steered else 0.0 for w in robot.wheels],
    )
