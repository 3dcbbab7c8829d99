"""Formats the results of a batch of scenario runs as a text table, a CSV file or a JSON file."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from thorvaldc.compiler.scenario.scenario_reader import metric_units
from thorvaldc.diagnostics.atomic_file import append_whole, errors_with_name, write_file
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.model.spatial import finite
from thorvaldc.tools.batch.scenario_batch import Run

SUFFIXES = (".csv", ".json")
# The columns of the text table: (metric, heading, format, factor).  The text of a cell is the
# metric times the factor.
_COLUMNS = (
    ("path", "true", "{:.3f} m", 1.0),
    ("end_error", "end error", "{:.1f} mm", 1000.0),
    ("length_ratio", "length ratio", "{:.5f}", 1.0),
    ("tilt", "tilt", "{:.2f} deg", math.degrees(1.0)),
    ("slip", "slip", "{:.4f} m/s", 1.0),
    ("collisions", "collisions", "{:.0f}", 1.0),
)


def runs_as_json(runs: Sequence[Run]) -> str:
    """Returns the results of all runs as a JSON list."""
    values = [finite(run.as_json()) for run in runs]
    return json.dumps(values, indent=1, ensure_ascii=False)


def results_table(runs: Sequence[Run], width: int | None = None) -> str:
    """Returns a text table of the results of the runs.

    The columns are the varied values, the metrics, the verdict and the hash of each run.
    ``width``: number of columns of the terminal, or ``None`` for one line per run.
    """
    has_fleet = any(run.result is not None and len(run.result["metrics"]) > 1 for run in runs)
    headings = [heading for _, heading, _, _ in _COLUMNS]
    rows = [["run", *runs[0].values, *(["robot"] * has_fleet), *headings, "", "hash"]]
    for run in runs:
        values = [_short_text(value) for value in run.values.values()]
        verdict = "ok" if run.passed else "FAILED"
        short_hash = run.result["hash"][:8] if run.result is not None else "-"
        for robot, metrics in _metrics_by_robot(run):
            cells = [
                form.format(factor * metrics[name]) if name in metrics else "-"
                for name, _, form, factor in _COLUMNS
            ]
            robot_cell = [robot] * has_fleet
            rows.append([str(run.number), *values, *robot_cell, *cells, verdict, short_hash])
    table = text_table(rows, width, right=range(len(rows[0])))
    failed = sum(1 for run in runs if not run.passed)
    verdicts = f"{failed} not as expected" if failed else "all as expected"
    noun = "run" if len(runs) == 1 else "runs"
    return "\n".join([table, f"{len(runs)} {noun}, {verdicts}"])


class ResultFile:
    """A CSV or JSON file with the results of a batch of runs.

    The result of each run is written when the run ends, so that a killed process loses no result
    of a finished run.  At the end of the batch, the file is replaced by one with the runs in order.
    A full disk leaves the results of the runs before.  Raises ``OSError`` if the file cannot be
    written.
    """

    def __init__(self, path: Path) -> None:
        self._is_csv = path.suffix.lower() == ".csv"
        self._path = path
        self._file = path.open("wb", buffering=0)
        self._runs: list[Run] = []

    def __enter__(self) -> ResultFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._file.close()
        runs = sorted(self._runs, key=lambda run: run.number)
        text = _csv_text(runs, heading=True) if self._is_csv else runs_as_json(runs) + "\n"
        write_file(self._path, text)

    def append(self, run: Run) -> None:
        """Appends the result of a finished run to the file."""
        self._runs.append(run)
        if self._is_csv:
            text = _csv_text([run], heading=len(self._runs) == 1)
        else:
            text = json.dumps(finite(run.as_json()), ensure_ascii=False) + "\n"
        with errors_with_name(self._path):
            append_whole(self._file.fileno(), text.encode())


def _csv_text(runs: Sequence[Run], *, heading: bool) -> str:
    """Returns one CSV line for each robot of each run.

    The columns of the CSV file are the varied values, all metrics in SI units, the verdict and the
    hash of the run.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    if heading and runs:
        writer.writerow(
            [
                "run",
                "robot",
                *runs[0].values,
                *metric_units(),
                "simulated",
                "passed",
                "hash",
                "faults",
            ]
        )
    for run in runs:
        values = [_value_text(value) for value in run.values.values()]
        for robot, metrics in _metrics_by_robot(run):
            simulated = run.result["run"]["simulated"] if run.result is not None else ""
            writer.writerow(
                [
                    run.number,
                    robot,
                    *values,
                    *(f"{metrics[name]:.9g}" if name in metrics else "" for name in metric_units()),
                    simulated,
                    str(run.passed).lower(),
                    run.result["hash"] if run.result is not None else "",
                    "; ".join(run.errors),
                ]
            )
    return stream.getvalue()


def _metrics_by_robot(run: Run) -> Iterator[tuple[str, Mapping[str, float]]]:
    if run.result is None:
        yield "", {}
        return
    yield from run.result["metrics"].items()


def _value_text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _short_text(value: Any) -> str:
    """Returns a value as text, with at most six significant digits for a float.

    Without rounding, a random value would have up to 17 digits.
    """
    if isinstance(value, float):
        return f"{value:.6g}"
    text = _value_text(value)
    number, _, unit = text.partition(" ")
    try:
        return f"{float(number):.6g} {unit}".rstrip() if len(number) > 8 else text
    except ValueError:
        return text
