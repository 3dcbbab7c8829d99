"""Writes the record of a run as CSV files, one file per robot.

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
from collections.abc import Iterator, Sequence
from pathlib import Path

from thorvaldc.compiler.recordings import csv_table
from thorvaldc.diagnostics.files import AtomicFile
from thorvaldc.model import Robot, wheel_joints
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.records import joint_csv
from thorvaldc.simulation.records.recorder import SampleInterval

_TWIST = ("vx", "vy", "wz")
_POSE = ("x", "y", "yaw")
COLUMNS = {
    "odometry": tuple(f"odometry_{part}" for part in (*_POSE, *_TWIST)),
    "truth": tuple(f"true_{part}" for part in (*_POSE, *_TWIST, "z", "roll", "pitch")),
    "twist": tuple(f"{twist}_{part}" for twist in ("asked", "aimed") for part in _TWIST),
}
"""Columns of the groups that have the same columns for every robot."""


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
