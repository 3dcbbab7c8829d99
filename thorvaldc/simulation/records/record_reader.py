"""Reads records of runs: the CSV files and MCAP files that ``sim --record`` writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thorvaldc.compiler.source.ros_bag import is_bag
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Robot
from thorvaldc.simulation.records.csv_record import read_csv_record
from thorvaldc.simulation.records.mcap_reader import read_mcap_record
from thorvaldc.simulation.records.recorded_run import RecordedRun


def read_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    """Returns the recorded runs by robot; ``None`` if the record is invalid.

    ``path`` is an MCAP file, a folder of CSV files or the CSV file of one robot.  The record
    of a single robot may have another robot name.  Problems go to ``report``.  Raises
    ``MissingPackageError`` if rosbags is needed and not installed.
    """
    display = str(path)
    if not path.exists():
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
        return None
    read = read_mcap_record if is_bag(path) else read_csv_record
    runs = read(path, robots, report)
    if runs is None or report.has_errors:
        return None
    for name, run in runs.items():
        if not run.samples:
            report.add("record-unreadable", f"`{display}` has no samples of {name}", Span(display))
            return None
    return runs
