"""The records and joint logs that a run writes.

All records and joint logs are opened before the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import typer

from thorvaldc.cli.exits import OutsideError, closing_when_terminated
from thorvaldc.compiler.recordings.ros_bag import MissingPackageError
from thorvaldc.diagnostics.atomic_file import AtomicFile
from thorvaldc.model import Robot
from thorvaldc.simulation.control_loop import ControlLoop, TickCallback
from thorvaldc.simulation.records.csv_record import CsvRecorder
from thorvaldc.simulation.records.joint_csv import JointLogWriter
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.records.recorder import Recorder

Robots = Sequence[tuple[str, Robot]]
_UNSUPPORTED_SUFFIXES = (".bag", ".db3", ".json", ".parquet", ".txt")


def open_recorders(
    record: str, robots: Robots, groups: Sequence[str], every: float, stack: ExitStack
) -> Sequence[Recorder]:
    """Opens the file or folder of the option ``--record`` and returns the recorder.

    An empty path means that the run is not recorded. A record path that ends in ``.mcap`` is one
    MCAP file for all robots. A record path that ends in ``.csv`` is a CSV file for one robot. Any
    other record path is a folder with a CSV file for each robot.

    - ``every``: recording period in s.
    - ``stack``: closes the recorder at the end of the run.
    """
    if not record:
        return ()
    path = Path(record)
    _check_path(path, record, len(robots))
    with write_errors(record):
        recorder: Recorder
        if path.suffix.lower() == ".mcap":
            recorder = McapRecorder(path, robots, groups, every)
        else:
            recorder = CsvRecorder(path, robots, groups, every)
    stack.enter_context(closing_when_terminated())
    stack.callback(recorder.close)
    return (recorder,)


def _check_path(path: Path, record: str, robot_count: int) -> None:
    suffix = path.suffix.lower()
    if suffix == ".csv" and robot_count > 1:
        raise typer.BadParameter(
            f"{robot_count} robots do not go into one CSV file; name a .mcap file, or a folder for"
            " CSV files",
            param_hint="'--record'",
        )
    if suffix in _UNSUPPORTED_SUFFIXES:
        kinds = "a .mcap file" if robot_count > 1 else "a .mcap or .csv file"
        raise typer.BadParameter(
            f"no record is a {suffix} file; name {kinds}, or a folder for CSV files",
            param_hint="'--record'",
        )
    if suffix not in (".mcap", ".csv") and path.is_file():
        raise OutsideError(f"cannot write {record}: it is a file; name a folder, or a .mcap file")


def record_summary(record: str, robots: Robots) -> str:
    """Returns the file names of a record as one line of text."""
    if Path(record).suffix.lower() in (".mcap", ".csv"):
        return record
    return f"{record}: {', '.join(f'{name}.csv' for name, _ in robots)}"


def open_joint_logs(log: str, robots: Robots, stack: ExitStack) -> TickCallback:
    """Opens the joint logs, and returns a function that writes the joint states of each tick.

    For one robot, ``log`` is the path of the joint log file. For several robots, ``log`` is the
    path of a folder with a joint log for each robot.
    """
    folder = Path(log)
    has_fleet = len(robots) > 1
    writers = {}
    with write_errors(log):
        if has_fleet:
            folder.mkdir(parents=True, exist_ok=True)
        for name, robot in robots:
            path = folder / f"{name}.csv" if has_fleet else folder
            file = AtomicFile(path, keep_incomplete=True)
            stack.callback(file.close)  # also after an error of the run
            writers[name] = JointLogWriter(robot, file)

    def watch(loop: ControlLoop) -> None:
        writers[loop.name].on_tick(loop)

    return watch


def call_all(watches: Sequence[TickCallback]) -> TickCallback:
    """Returns a function that calls each callback in ``watches``."""

    def watch(loop: ControlLoop) -> None:
        for call in watches:
            call(loop)

    return watch


@contextmanager
def write_errors(path: str) -> Iterator[None]:
    """Converts the exception for an unwritable file or a missing package to ``OutsideError``."""
    try:
        yield
    except MissingPackageError as error:
        raise OutsideError(str(error)) from None
    except OSError as error:
        name = error.filename or path
        raise OutsideError(f"cannot write {name}: {error.strerror or error}") from None
