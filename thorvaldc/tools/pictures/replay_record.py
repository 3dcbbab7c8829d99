"""Reads a record for a replay and checks that the record has the required groups of values."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Robot
from thorvaldc.simulation.records.record_reader import read_record
from thorvaldc.simulation.records.recorder import RecordedRun

PLOTTED_GROUPS = ("odometry", "truth")


def read_replay_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report, *, for_plot: bool = False
) -> dict[str, RecordedRun] | None:
    """Returns the recorded runs by robot name.

    A replay requires the group ``odometry`` or the group ``truth`` in the record.  A plot requires
    the group ``odometry`` and the group ``truth`` in the record.  If the record is invalid or a
    group is missing, the function adds errors to ``report`` and returns ``None``.
    """
    runs = read_record(path, robots, report)
    if runs is None:
        return None
    for name, run in runs.items():
        missing = [group for group in PLOTTED_GROUPS if group not in run.groups]
        if for_plot and missing:
            report.add(
                "record-incomplete",
                f"`{path}` has no {' and no '.join(missing)} of {name}; --plot needs "
                f"{' and '.join(PLOTTED_GROUPS)}",
                Span(str(path)),
            )
        if len(missing) == len(PLOTTED_GROUPS):
            report.add(
                "record-incomplete",
                f"`{path}` has neither odometry nor truth of {name}",
                Span(str(path)),
                hint="name one of them in `record: {what: ..}`, or leave `what` out",
            )
    return None if report.has_errors else runs


def text_sources(path: Path) -> dict[str, Path]:
    """Returns the CSV files of a record by the file names in the diagnostics.

    The report uses the CSV files to show excerpts.
    """
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    return {str(file): file for file in files if file.suffix == ".csv"}
