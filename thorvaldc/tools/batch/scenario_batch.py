"""Runs many variations of a scenario in one or more processes.

The results do not depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from thorvaldc.backends.mjcf import simulation_files
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.scenario.variations import (
    Change,
    Variations,
)
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.worker_processes import ignored_interrupts, worker_pool


@dataclass(frozen=True, slots=True)
class Run:
    """The run of one variation of a scenario.

    * ``number``: number of the run, from 1 on.
    * ``values``: varied values by their path in the document.
    * ``result``: ``ScenarioResult.as_json()`` without the real time factor, or ``None`` if the run
      could not start.  The real time factor is omitted because it depends on the machine.
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


class Batch:
    """The runs of all variations of a scenario.

    Each variation is compiled and simulated independently of the other variations.  The result of
    a variation in a batch is thus equal to the result of the same variation alone.
    """

    def __init__(
        self,
        scenario: Path | str,
        variations: Variations,
        *,
        robot: Path | str | None = None,
        library: Sequence[Path] = (),
        trust: bool = False,
    ) -> None:
        self.variations = variations
        self._jobs = [
            _Job(
                number,
                str(scenario),
                changes,
                None if robot is None else str(robot),
                library,
                trust,
            )
            for number, changes in enumerate(variations.runs(), 1)
        ]

    def __len__(self) -> int:
        return len(self._jobs)

    def check(self) -> Compilation | None:
        """Compiles the scenario once with each varied value, before the runs start.

        Each varied value is combined with the other values of the first run.  Returns the first
        compilation with errors, or ``None`` if all compilations succeed.
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
        """Simulates the variations and yields each run when the run ends.

        ``jobs`` is the number of processes.  With ``jobs=1`` the runs are simulated in the current
        process.  If the caller closes the iterator, or an interrupt occurs, the remaining runs are
        cancelled.  Raises ``BrokenProcessPool`` if a process was killed.
        """
        if jobs <= 1 or len(self._jobs) <= 1:
            for job in self._jobs:
                yield job()
            return
        try:
            with worker_pool(min(jobs, len(self._jobs))) as pool:
                with ignored_interrupts():
                    futures: list[Future[Run]] = [pool.submit(job) for job in self._jobs]
                for future in as_completed(futures):
                    yield future.result()
        except BrokenProcessPool:
            raise BrokenProcessPool("a process of the batch was killed") from None


@dataclass(frozen=True, slots=True)
class _Job:
    """The arguments of the run of one variation, passed to another process."""

    number: int
    scenario: str
    changes: tuple[Change, ...]
    robot: str | None
    library: Sequence[Path]
    trust: bool

    def with_changes(self, changes: tuple[Change, ...]) -> _Job:
        return replace(self, changes=changes)

    def compile(self) -> Compilation:
        return compile_file(
            self.scenario,
            library=self.library,
            robot=self.robot,
            changes=self.changes,
            trust=self.trust,
        )

    def __call__(self) -> Run:
        from thorvaldc.diagnostics import DiagnosticError
        from thorvaldc.simulation.scenario_run import ScenarioSimulation

        values = {change.path: change.value.plain() for change in self.changes}
        compilation = self.compile()
        report = Report()
        report.extend(compilation.report)
        result = None
        if compilation.scenario is not None:
            try:
                files = simulation_files(compilation.scenario.fleet)
                simulation = ScenarioSimulation(compilation.scenario, files)
                result = simulation.play(report).as_json()
                result["run"].pop("real_time_factor")
            except DiagnosticError as error:
                report.put(error.diagnostic)
        errors = tuple(f"{d.code.severity}[{d.code.number}]: {d.message}" for d in report.errors)
        return Run(self.number, values, result, errors)
