"""Runs a scenario with all combinations of some values, in one or more processes.

The results do not depend on the number of processes.  They are a text table, JSON or a CSV file.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.backends.mjcf import simulation_files
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.scenario.scenario_compilation import metric_units
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import DiagnosticError, files
from thorvaldc.diagnostics.files import finite
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.worker_processes import ignored_interrupts, worker_pool


@dataclass(frozen=True, slots=True)
class Run:
    """A run of a sweep.

    * ``number``: number of the run, from 1 on.
    * ``values``: varied values by their path in the document.
    * ``result``: ``ScenarioResult.as_json()`` without the real time factor, which depends on the
      machine, or ``None`` if the run could not start.
    * ``errors``: error messages of the run.
    """

    number: int
    values: Mapping[str, Any]
    result: Mapping[str, Any] | None
    errors: tuple[str, ...]

    @property
    def passed(self) -> bool:
        return self.result is not None and bool(self.result["passed"])

    def as_json(self) -> dict[str, Any]:
        """Returns the run as JSON values."""
        return {
            "number": self.number,
            "values": dict(self.values),
            "passed": self.passed,
            "result": None if self.result is None else dict(self.result),
            "faults": list(self.errors),
        }


@dataclass(frozen=True, slots=True)
class Sweep:
    """The runs of a scenario with all combinations of values.

    Each run is compiled and simulated for itself: its result is that of the same run alone.

    * ``scenario``: path of the scenario file.
    * ``choices``: values by their path in the document; the value of the last path changes first.
    * ``robot``, ``library``, ``trust``: see ``compile_file``.
    """

    scenario: Path | str
    choices: Mapping[str, Sequence[Node]]
    robot: Path | str | None = None
    library: Sequence[Path] = ()
    trust: bool = False

    def __len__(self) -> int:
        return math.prod(map(len, self.choices.values()))

    def __iter__(self) -> Iterator[Mapping[str, Node]]:
        """Yields the values of each run."""
        for values in itertools.product(*self.choices.values()):
            yield dict(zip(self.choices, values, strict=True))

    def check(self) -> Compilation:
        """Compiles the scenario with each value and the first ones of all other paths.

        Of numbers, it compiles the smallest and the largest: a value between two that fit is
        compiled by its run alone.  Returns the first compilation with errors, or one without.
        """
        first = next(iter(self))
        compilation = self.compile(first)
        for path, values in self.choices.items():
            for value in _extremes(values[1:]):
                if compilation.model is not None:
                    compilation = self.compile({**first, path: value})
        return compilation

    def compile(self, values: Mapping[str, Node]) -> Compilation:
        return compile_file(
            self.scenario, library=self.library, robot=self.robot, set=values, trust=self.trust
        )

    def runs(self, jobs: int = 1) -> Iterator[Run]:
        """Simulates the runs, and yields each one when it ends.

        ``jobs`` is the number of processes.  If the caller closes the iterator, or an interrupt
        occurs, the remaining runs are cancelled.  Raises ``BrokenProcessPool`` if a process was
        killed.
        """
        if jobs <= 1:
            yield from itertools.starmap(self._run, enumerate(self, 1))
            return
        try:
            with worker_pool(min(jobs, len(self))) as pool:
                with ignored_interrupts():
                    futures: list[Future[Run]] = [
                        pool.submit(self._run, number, values)
                        for number, values in enumerate(self, 1)
                    ]
                for future in as_completed(futures):
                    yield future.result()
        except BrokenProcessPool:
            raise BrokenProcessPool("a process of the sweep was killed") from None

    def _run(self, number: int, values: Mapping[str, Node]) -> Run:
        compilation = self.compile(values)
        report, result = compilation.report, None
        if compilation.scenario is not None:
            try:
                scene = simulation_files(compilation.scenario.fleet)
                simulation = ScenarioSimulation(compilation.scenario, scene)
                result = simulation.play(report).as_json()
                result["run"].pop("real_time_factor")
            except DiagnosticError as error:
                report.put(error.diagnostic)
        errors = tuple(f"{d.code.severity}[{d.code.number}]: {d.message}" for d in report.errors)
        plain = {path: value.plain() for path, value in values.items()}
        return Run(number, plain, result, errors)


def _extremes(values: Sequence[Node]) -> list[Node]:
    """Returns the values without the numbers between the smallest and the largest of their type."""
    numbers: dict[type, list[Node]] = {}
    others: list[Node] = []
    for value in values:
        kind = type(value.plain())
        (numbers.setdefault(kind, []) if kind in (int, float) else others).append(value)
    for same in numbers.values():
        same.sort(key=Node.plain)
        others += same if len(same) < 3 else (same[0], same[-1])
    return others


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
    return json.dumps([finite(run.as_json()) for run in runs], indent=1, ensure_ascii=False)


def results_table(runs: Sequence[Run], width: int | None = None, number: int | None = None) -> str:
    """Returns a text table of the results of the runs.

    The columns are the varied values, the metrics, the verdict and the hash of each run.
    ``width``: number of columns of the terminal, or ``None`` for one line per run.  ``number``:
    number of runs of the sweep, if it can have been interrupted.
    """
    has_fleet = any(run.result is not None and len(run.result["metrics"]) > 1 for run in runs)
    headings = [heading for _, heading, _, _ in _COLUMNS]
    rows = [["run", *runs[0].values, *(["robot"] * has_fleet), *headings, "", "hash"]]
    for run in runs:
        values = [_value_text(value) for value in run.values.values()]
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
    if number is not None and len(runs) < number:
        return "\n".join([table, f"{len(runs)} of {number} runs, {failed} not as expected"])
    noun = "run" if len(runs) == 1 else "runs"
    return "\n".join([table, f"{len(runs)} {noun}, {verdicts}"])


class ResultFile:
    """A CSV file with the results of a sweep.

    The result of each run is written when the run ends, so that a killed process loses no result
    of a finished run.  At the end, the file is replaced by one with the runs in order.  A full disk
    leaves the results of the runs before.  Raises ``OSError`` if the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("wb", buffering=0)
        self._runs: list[Run] = []

    def __enter__(self) -> ResultFile:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()
        runs = sorted(self._runs, key=lambda run: run.number)
        files.write_file(self._path, _csv_text(runs, heading=True))

    def append(self, run: Run) -> None:
        """Appends the result of a finished run to the file."""
        self._runs.append(run)
        text = _csv_text([run], heading=len(self._runs) == 1)
        with files.errors_with_name(self._path):
            files.append_whole(self._file.fileno(), text.encode())


def _csv_text(runs: Sequence[Run], *, heading: bool) -> str:
    """Returns one CSV line for each robot of each run.

    The columns of the CSV file are the varied values, all metrics in SI units, the verdict and the
    hash of the run.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    if heading and runs:
        verdict = ("simulated", "passed", "hash", "faults")
        writer.writerow(["run", "robot", *runs[0].values, *metric_units(), *verdict])
    for run in runs:
        values = [_value_text(value) for value in run.values.values()]
        for robot, metrics in _metrics_by_robot(run):
            numbers = [f"{metrics[name]:.9g}" if name in metrics else "" for name in metric_units()]
            result = run.result or {"run": {"simulated": ""}, "hash": ""}
            simulated, passed = result["run"]["simulated"], str(run.passed).lower()
            verdict = (simulated, passed, result["hash"], "; ".join(run.errors))
            writer.writerow([run.number, robot, *values, *numbers, *verdict])
    return stream.getvalue()


def _metrics_by_robot(run: Run) -> Iterator[tuple[str, Mapping[str, float]]]:
    yield from run.result["metrics"].items() if run.result is not None else [("", {})]


def _value_text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
