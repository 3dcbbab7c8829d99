"""What a run writes while it runs: records and joint logs, opened before it begins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from thorvaldc.cli.exits import OutsideError, closing_when_terminated

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.simulation.control_loop import TickCallback
    from thorvaldc.simulation.records.recorder import Recorder

Robots = Sequence[tuple[str, "Robot"]]
_OTHERS = (".bag", ".db3", ".json", ".parquet", ".txt")


def open_recorder(
    record: str, robots: Robots, groups: Sequence[str], every: float, stack: ExitStack
) -> Sequence[Recorder]:
    """The recorder to ``record``, none for an empty one; ``stack`` closes it.

    ``*.mcap`` is one file of all robots, ``*.csv`` the file of one robot, all else a folder of
    CSV files.
    """
    if not record:
        return ()
    path = Path(record)
    kind = path.suffix.lower()
    if kind in _OTHERS or (kind == ".csv" and len(robots) > 1):
        wrong = f"no record is a {kind} file"
        right = "a .mcap or .csv file, or a folder for CSV files"
        if len(robots) > 1:
            right = "a .mcap file, or a folder for CSV files"
        if kind == ".csv":
            wrong = f"{len(robots)} robots do not go into one CSV file"
        raise typer.BadParameter(f"{wrong}; name {right}", param_hint="'--record'")
    if kind not in (".mcap", ".csv") and path.is_file():
        raise OutsideError(f"cannot write {record}: it is a file; name a folder, or a .mcap file")
    with writing(record):
        if kind == ".mcap":
            from thorvaldc.simulation.records.mcap_writer import McapRecorder

            recorder: Recorder = McapRecorder(path, robots, groups, every)
        else:
            from thorvaldc.simulation.records.csv_record import CsvRecorder

            recorder = CsvRecorder(path, robots, groups, every)
    stack.enter_context(closing_when_terminated())
    stack.callback(recorder.close)
    return (recorder,)


def recorded(record: str, robots: Robots) -> str:
    """What the user is told of a record that is written."""
    if Path(record).suffix.lower() in (".mcap", ".csv"):
        return record
    return f"{record}: {', '.join(f'{name}.csv' for name, _ in robots)}"


def open_logs(log: str, robots: Robots, stack: ExitStack) -> TickCallback:
    """What writes the joint logs: of one robot to the file ``log``, of several to a folder."""
    from thorvaldc.simulation.control_loop import ControlLoop
    from thorvaldc.simulation.records.joint_csv import JointLogWriter
    from thorvaldc.simulation.records.recorder import errors_with_name

    folder = Path(log)
    several = len(robots) > 1
    writers, paths = {}, {}
    with writing(log):
        if several:
            folder.mkdir(parents=True, exist_ok=True)
        for name, robot in robots:
            path = folder / f"{name}.csv" if several else folder
            stream = path.open("w", encoding="utf-8", newline="\n")
            stack.enter_context(errors_with_name(path))  # of what is found when it is closed
            stack.enter_context(stream)
            writers[name], paths[name] = JointLogWriter(robot, stream), path

    def watch(loop: ControlLoop) -> None:
        with errors_with_name(paths[loop.name]):
            writers[loop.name].on_tick(loop)

    return watch


def each(watches: Sequence[TickCallback]) -> TickCallback:
    """One watch that calls them all."""
    from thorvaldc.simulation.control_loop import ControlLoop

    def watch(loop: ControlLoop) -> None:
        for one in watches:
            one(loop)

    return watch


@contextmanager
def writing(path: str) -> Iterator[None]:
    """What cannot be written, as a fault of the world."""
    from thorvaldc.compiler.source.ros_bag import MissingPackageError

    try:
        yield
    except MissingPackageError as fault:
        raise OutsideError(str(fault)) from None
    except OSError as fault:
        name = fault.filename or path
        raise OutsideError(f"cannot write {name}: {fault.strerror or fault}") from None
