"""Runs many variations of a scenario, over one or more processes with equal results."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.compilation import Compilation
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.compiler.scenario.variations import (
    Change,
    Variations,
    read_variations,
    without_variations,
)
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.diagnostics import Report

__all__ = ["Batch", "Run", "plan_variations", "processors"]


def plan_variations(
    path: Path | str,
    settings: Sequence[str] = (),
    draws: int | None = None,
    seed: int | None = None,
    *,
    from_document: bool = True,
    report: Report,
) -> Variations | None:
    """Returns the variations of a scenario: those of its document, and ``settings``.

    With ``from_document=False`` only the settings.  Returns ``None`` if the file is not a
    scenario.  For the arguments see ``read_variations``.
    """
    document_report = Report()  # compile_file reports these problems again, so they are dropped
    document = read_file(Path(path), str(path), document_report)
    if document is None:
        report.extend(document_report)
        return Variations(())
    if document.get("scenario") is None:
        return None
    check(document, "scenario", document_report)
    document = without_invalid_values(document, document_report)
    if not from_document:
        document = without_variations(document)
    return read_variations(document, settings, draws, seed, report)


@dataclass(frozen=True, slots=True)
class Run:
    """The run of one variation: its number (from 1), its values by path, and its result.

    ``result`` is ``ScenarioResult.as_json()`` without the real time factor, which depends on
    the machine; ``None`` if the run could not start.  ``errors`` are its error messages.
    """

    number: int
    values: Mapping[str, Any]
    result: Mapping[str, Any] | None
    errors: tuple[str, ...]

    @property
    def passed(self) -> bool:
        return self.result is not None and bool(self.result["passed"])

    def as_json(self) -> dict[str, Any]:
        """Returns the run as plain values."""
        return {
            "number": self.number,
            "values": dict(self.values),
            "passed": self.passed,
            "result": None if self.result is None else dict(self.result),
            "faults": list(self.errors),
        }


class Batch:
    """The runs of a scenario's variations.

    Each run is compiled and simulated independently, so its result is the same as that of a
    single run.
    """

    def __init__(
        self,
        scenario: Path | str,
        variations: Variations,
        *,
        robot: Path | str | None = None,
        library: Sequence[Path] = (),
    ) -> None:
        self.variations = variations
        self._jobs = [
            _Job(number, str(scenario), changes, None if robot is None else str(robot), library)
            for number, changes in enumerate(variations.runs(), 1)
        ]

    def __len__(self) -> int:
        return len(self._jobs)

    def check(self) -> Compilation | None:
        """Compiles each value once before the runs; returns the first compilation with errors.

        Each value is combined with the other values of the first run.  ``None``: no errors.
        """
        if not self._jobs:
            return None
        first = self._jobs[0]
        combinations = [first.changes]
        for change in self.variations.single_changes():
            if change not in first.changes:
                others = (c for c in first.changes if c.path != change.path)
                combinations.append((*others, change))
        for changes in combinations:
            compilation = first.with_changes(changes).compile()
            if compilation.model is None:
                return compilation
        return None

    def runs(self, jobs: int = 1) -> Iterator[Run]:
        """Yields the runs in the order in which they end, over ``jobs`` processes (1: this one).

        Raises ``BrokenProcessPool`` if a process was killed.  If the caller closes the
        iterator or an interrupt ends it, the remaining runs are cancelled.
        """
        if jobs <= 1 or len(self._jobs) <= 1:
            for job in self._jobs:
                yield job()
            return
        # A forked process would inherit locks and threads of MuJoCo and numpy.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(min(jobs, len(self._jobs)), mp_context=context)
        try:
            with _ignored_interrupts():
                futures: list[Future[Run]] = [pool.submit(job) for job in self._jobs]
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool:
            raise BrokenProcessPool("a process of the batch was killed") from None
        except BaseException:
            for process in multiprocessing.active_children():
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@dataclass(frozen=True, slots=True)
class _Job:
    """One run, with all that a process needs for it."""

    number: int
    scenario: str
    changes: tuple[Change, ...]
    robot: str | None
    library: Sequence[Path]

    def with_changes(self, changes: tuple[Change, ...]) -> _Job:
        return _Job(self.number, self.scenario, changes, self.robot, self.library)

    def compile(self) -> Compilation:
        return compile_file(
            self.scenario, library=self.library, robot=self.robot, changes=self.changes
        )

    def __call__(self) -> Run:
        from thorvaldc.diagnostics.error import DiagnosticError
        from thorvaldc.simulation.scenario_run import ScenarioSimulation

        values = {change.path: change.value.plain() for change in self.changes}
        compilation = self.compile()
        report = Report()
        report.extend(compilation.report)
        result = None
        if compilation.scenario is not None:
            try:
                files = emit(compilation.scenario.fleet, ["mjcf"], report)
                simulation = ScenarioSimulation(compilation.scenario, files)
                result = simulation.play(report).as_json()
                result["run"].pop("real_time_factor")
            except DiagnosticError as error:
                report.put(error.diagnostic)
        errors = tuple(f"{d.code.severity}[{d.code.number}]: {d.message}" for d in report.errors)
        return Run(self.number, values, result, errors)


@contextmanager
def _ignored_interrupts() -> Iterator[None]:
    """Processes that start in this block ignore Ctrl-C; their parent terminates them.

    A terminal sends Ctrl-C to all processes, and each would print a traceback.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def processors() -> int:
    """Returns the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
