"""Many variations of one scenario, over processes; what comes out does not depend on how many."""

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
    own: bool = True,
    report: Report,
) -> Variations | None:
    """What varies in the runs of a scenario: what its document says, and ``settings``.

    Without ``own`` the settings alone; ``None`` where the file is no scenario.  See
    ``passes.variations.read_variations``.
    """
    shape, said = Report(), Report()
    document = read_file(Path(path), str(path), shape)
    if document is None:
        report.extend(shape)
        return Variations(())
    if document.get("scenario") is None:
        return None
    check(document, "scenario", shape)
    document = without_invalid_values(document, shape)
    if not own:
        document = without_variations(document)
    found = read_variations(document, settings, draws, seed, said)
    report.extend(said)
    return found


@dataclass(frozen=True, slots=True)
class Run:
    """One variation's run: its number from 1 on, its values by path, and what came of it.

    ``result`` is ``ScenarioResult.as_json()`` without what depends on the machine's speed,
    ``None`` where it could not start; ``faults`` are what was said of it.
    """

    number: int
    values: Mapping[str, Any]
    result: Mapping[str, Any] | None
    faults: tuple[str, ...]

    @property
    def passed(self) -> bool:
        return self.result is not None and bool(self.result["passed"])

    def as_json(self) -> dict[str, Any]:
        """The run as plain values."""
        return {
            "number": self.number,
            "values": dict(self.values),
            "passed": self.passed,
            "result": None if self.result is None else dict(self.result),
            "faults": list(self.faults),
        }


class Batch:
    """The runs of a scenario's variations.

    Each is compiled and simulated by itself, so that its result is that of the run alone.
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
        self._work = [
            _Work(number, str(scenario), changes, None if robot is None else str(robot), library)
            for number, changes in enumerate(variations.all(), 1)
        ]

    def __len__(self) -> int:
        return len(self._work)

    def check(self) -> Compilation | None:
        """What is wrong with one of the values, found before anything runs; ``None``: nothing.

        Each value is tried beside those of the first run.
        """
        if not self._work:
            return None
        first = self._work[0]
        tried = [first.changes]
        for change in self.variations.single():
            if change not in first.changes:
                others = (c for c in first.changes if c.path != change.path)
                tried.append((*others, change))
        for changes in tried:
            done = first._replace_changes(changes).compiled()
            if done.model is None:
                return done
        return None

    def runs(self, jobs: int = 1) -> Iterator[Run]:
        """Every run as it ends, over so many processes (1: in this one).

        Raises ``BrokenProcessPool`` where one of them was killed.  What is left when the
        iterator is closed, or interrupted, is given up.
        """
        if jobs <= 1 or len(self._work) <= 1:
            for work in self._work:
                yield work()
            return
        # Spawned: a fork would share what MuJoCo and numpy have begun.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(min(jobs, len(self._work)), mp_context=context)
        try:
            with _deaf_to_interrupts():
                futures: list[Future[Run]] = [pool.submit(work) for work in self._work]
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
class _Work:
    number: int
    scenario: str
    changes: tuple[Change, ...]
    robot: str | None
    library: Sequence[Path]

    def _replace_changes(self, changes: tuple[Change, ...]) -> _Work:
        return _Work(self.number, self.scenario, changes, self.robot, self.library)

    def compiled(self) -> Compilation:
        return compile_file(
            self.scenario, library=self.library, robot=self.robot, changes=self.changes
        )

    def __call__(self) -> Run:
        from thorvaldc.diagnostics.error import DiagnosticError
        from thorvaldc.simulation.scenario_run import ScenarioSimulation

        values = {change.path: change.value.plain() for change in self.changes}
        done = self.compiled()
        report = Report()
        report.extend(done.report)
        result = None
        if done.scenario is not None:
            try:
                files = emit(done.scenario.fleet, ["mjcf"], report)
                result = ScenarioSimulation(done.scenario, files).play(report).as_json()
                result["run"].pop("real_time_factor")
            except DiagnosticError as fault:
                report.put(fault.diagnostic)
        said = tuple(f"{d.code.severity}[{d.code.number}]: {d.message}" for d in report.errors)
        return Run(self.number, values, result, said)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes that begin in here do not hear Ctrl-C; whoever began them ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
