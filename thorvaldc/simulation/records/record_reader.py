"""Reads recorded runs from the CSV and MCAP files that ``sim --record`` writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thorvaldc.compiler.recordings.ros_bag import is_bag
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Robot
from thorvaldc.simulation.records.csv_record import read_csv_record
from thorvaldc.simulation.records.mcap_reader import read_mcap_record
from thorvaldc.simulation.records.recorded_run import RecordedRun


def read_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    """Returns the recorded runs by robot name.

    ``path`` is an MCAP file, a folder of CSV files or the CSV file of one robot.  The robot name
    in a record of a single robot may differ from the name in ``robots``.  If the record is invalid,
    the function adds the problems to ``report`` and returns ``None``.  Raises
    ``MissingPackageError`` if the record is an MCAP file and rosbags is not installed.
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
