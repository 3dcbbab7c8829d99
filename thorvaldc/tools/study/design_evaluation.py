"""Evaluates designs of a study, in this process or in several.

A design is compiled, its constraints are checked and its scenarios driven.  A process that is
killed, for example because the computer has no memory left, does not end the study.
"""

from __future__ import annotations

import functools
import gc
import math
import os
import pickle
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.backends.mjcf import simulation_files
from thorvaldc.compiler.pipeline import compile_robot, many_compilations
from thorvaldc.compiler.result import Compilation, SourceFile
from thorvaldc.compiler.scenario.scenario_compilation import compile_scenario
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.diagnostics import Diagnostic, DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.masses import PurchaseFacts, purchase_of
from thorvaldc.model.facts.robot_facts import fact_quantity, fact_sections, json_value
from thorvaldc.simulation.worker_processes import ignored_interrupts, worker_pool
from thorvaldc.tools.study.design_text import PathError, with_replaced_values
from thorvaldc.tools.study.study_compilation import fact_values
from thorvaldc.tools.study.study_definition import Design, Study
from thorvaldc.tools.study.study_results import quantity_text

_STATUS_OF_CODE = {
    "simulation-tipped": "tipped",
    "simulation-diverged": "diverged",
    "expectation-failed": "expectation",
}


@dataclass(frozen=True, slots=True)
class StudyInputs:
    """All that a process needs to evaluate the designs of a study.

    - ``text``: text of the robot file.
    - ``library``: additional library folders.
    - ``trust``: whether xacro files are expanded without restrictions.
    - ``files``: all files of the study.
    """

    study: Study
    text: str
    library: Sequence[Path]
    trust: bool
    files: tuple[Path, ...] = ()


class DesignEvaluator:
    """Evaluates designs of a study one after the other.

    Each design is the text of the robot file with replaced values, so that the winning robot file
    is compiled from the text that was simulated.  The designs share the parsed library, the xacro
    expansions, the buses of equal devices and the mesh workers.

    ``stack`` : the worker processes end when the stack is closed.
    """

    def __init__(self, inputs: StudyInputs, stack: ExitStack) -> None:
        stack.enter_context(many_compilations())
        self.inputs = inputs
        self.study = inputs.study

    def evaluate(self, design: Design) -> dict[str, Any]:
        """Returns the result of a design as JSON values.

        The keys are ``status``, ``code``, ``message``, ``facts`` by path, and ``metrics`` by
        scenario.  A design never raises an exception: a design that cannot be compiled or driven is
        a result with the first error.
        """
        row: dict[str, Any] = {"status": "ok", "code": "", "message": "", "facts": {}}
        row["metrics"] = {}
        try:
            with _paused_collection():
                self._evaluate(design, row)
        except DiagnosticError as error:
            _set_error(row, error.diagnostic)
        except PathError as error:
            row.update(status="error", message=str(error))
        except Exception as error:
            # One design among thousands must not end a study of hours, whatever its error is.
            row.update(status="error", message=f"{type(error).__name__}: {error}")
        return row

    def _evaluate(self, design: Design, row: dict[str, Any]) -> None:
        robot_path = self.study.robot
        text = robot_text(self.inputs, design)
        with unsaved_texts({os.path.realpath(robot_path): text.encode()}):
            source = SourceFile(robot_path, robot_path.name, robot_path.parent)
            compilation = compile_robot(source, self.inputs.library, self.inputs.trust)
            if not isinstance(compilation.model, Robot):
                _set_error(row, compilation.report.errors[0])
                return
            purchase = purchase_of(compilation.model)
            row["facts"] = self._facts(compilation.model, purchase)
            message = self._broken_constraint(row["facts"], purchase)
            if message:
                row.update(status="constraint", message=message)
                return
            for name, path in self.study.scenarios:
                if not self._drive(name, path, compilation, row):
                    return

    def _facts(self, robot: Robot, purchase: PurchaseFacts) -> dict[str, float | None]:
        """Returns the facts that the study needs.  A price in another currency than that of the
        study's robot is ``None``, because nobody can compare it."""
        paths = sorted(set(self.study.facts()))
        sections = fact_sections(robot, {path.partition(".")[0] for path in paths})
        values = dict(fact_values({name: json_value(part) for name, part in sections.items()}))
        if purchase.currency != self.study.currency:
            values = {path: v for path, v in values.items() if fact_quantity(path) != si.MONEY}
        return {path: values.get(path) for path in paths}

    def _broken_constraint(self, facts: dict[str, float | None], purchase: PurchaseFacts) -> str:
        for constraint in self.study.constraints:
            value = facts[constraint.fact]
            if value is None:
                reason = ""
                if fact_quantity(constraint.fact) == si.MONEY:
                    reason = purchase.no_price or f"its prices are in {purchase.currency}"
                return f"{constraint.name}: the design has no {constraint.fact}" + (
                    f": {reason}" if reason else ""
                )
            text = functools.partial(quantity_text, unit=fact_quantity(constraint.fact).unit)
            least, most = constraint.at_least, constraint.at_most
            if least is not None and value < least:
                return f"{constraint.name} is {text(value)}, less than {text(least)}"
            if most is not None and value > most:
                return f"{constraint.name} is {text(value)}, more than {text(most)}"
        return ""

    def _drive(self, name: str, path: Path, robot: Compilation, row: dict[str, Any]) -> bool:
        """Runs a scenario, adds its metrics, and returns whether the design passed it."""
        from thorvaldc.simulation.scenario_run import ScenarioSimulation

        source = SourceFile(path, path.name, path.parent)
        compilation = compile_scenario(source, lambda part: robot, self.study.robot)
        if compilation.scenario is None:
            _set_error(row, compilation.report.errors[0])
            return False
        report = Report()
        files = simulation_files(compilation.scenario.fleet)
        result = ScenarioSimulation(compilation.scenario, files).play(
            report, hashed=False, ends_early=True
        )
        (metrics,) = result.metrics.values()
        row["metrics"][name] = {
            metric: value if math.isfinite(value) else None for metric, value in metrics.items()
        }
        if result.passed:
            return True
        errors = sorted(report.errors, key=lambda error: error.code.name == "expectation-failed")
        _set_error(row, errors[0])
        return False


def robot_text(inputs: StudyInputs, design: Design) -> str:
    """Returns the text of the robot file with the values of a design.

    Raises ``PathError`` if a value cannot be replaced.
    """
    pairs = zip(inputs.study.variables, design, strict=True)
    return with_replaced_values(
        inputs.text, [(path, value) for variable, value in pairs for path in variable.paths]
    )


@contextmanager
def _paused_collection() -> Iterator[None]:
    """Pauses the garbage collection, which takes 7 % of the time of a design and finds little."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _set_error(row: dict[str, Any], diagnostic: Diagnostic) -> None:
    status = _STATUS_OF_CODE.get(diagnostic.code.name, "error")
    row.update(status=status, code=diagnostic.code.number, message=diagnostic.message)


WAITING_PER_PROCESS = 2
"""Number of designs that a process has at once, so that it never waits for the next."""
ATTEMPTS = 3
"""Number of processes that a design may end before it counts as failed."""

_Item = tuple[str, Design]
Result = tuple[str, dict[str, Any] | None]
"""Key of a design, and its result or ``None``."""


class DesignProcesses:
    """Processes that evaluate designs of a study, for several batches of designs.

    - ``jobs``: number of processes.  The first designs start them.
    - ``stack``: the processes end when the stack is closed.
    """

    def __init__(self, inputs: StudyInputs, jobs: int, stack: ExitStack) -> None:
        self._pickled = pickle.dumps(inputs)
        self._jobs = jobs
        self._stack = stack.enter_context(ExitStack())
        self._pool: ProcessPoolExecutor | None = None
        self._processes = 0

    def results(self, designs: Iterable[_Item]) -> Iterator[Result]:
        """Yields the key and the result of each design, in the order in which they finish.

        - ``designs``: key and values of each design.

        If a process is killed, for example because the computer has no memory left, the designs of
        all processes are evaluated again, one after the other.  A design whose process is then
        killed ``ATTEMPTS`` times has the result ``None``.
        """
        remaining = iter(designs)
        while lost := (yield from self._evaluated(remaining, self._jobs)):
            yield from self._one_by_one(lost)

    def _one_by_one(self, designs: list[_Item]) -> Iterator[Result]:
        attempts: Counter[str] = Counter()
        while designs:
            remaining = iter(designs)
            lost = yield from self._evaluated(remaining, 1)
            designs = [*lost, *remaining]
            for key, _ in lost:  # one design at most
                attempts[key] += 1
                if attempts[key] == ATTEMPTS:
                    designs = designs[1:]
                    yield key, None

    def _evaluated(
        self, designs: Iterator[_Item], processes: int
    ) -> Generator[Result, None, list[_Item]]:
        """Yields results until all designs are evaluated or a process is killed.

        Returns the designs that were taken from ``designs`` and have no result.
        """
        most = 1 if processes == 1 else processes * WAITING_PER_PROCESS
        running: dict[Future[dict[str, Any]], _Item] = {}
        item: _Item | None = None
        try:
            pool = self._open_pool(processes)
            while True:
                while len(running) < most and (item := next(designs, None)):
                    running[_submitted(pool, self._pickled, item[1])] = item
                    item = None
                if not running:
                    return []
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future)[0], result
        except BrokenProcessPool:
            self._close_pool()
            return [*running.values(), *([item] if item else [])]

    def _open_pool(self, processes: int) -> ProcessPoolExecutor:
        if self._pool is None or self._processes != processes:
            self._close_pool()
            self._pool = self._stack.enter_context(worker_pool(processes))
            self._processes = processes
        return self._pool

    def _close_pool(self) -> None:
        self._pool = None
        self._stack.close()


def _submitted(pool: ProcessPoolExecutor, pickled: bytes, design: Design) -> Future[dict[str, Any]]:
    with ignored_interrupts():
        return pool.submit(_evaluate, pickled, design)


_open = ExitStack()


@functools.lru_cache(maxsize=1)
def _evaluator(pickled: bytes) -> DesignEvaluator:
    _open.close()
    return DesignEvaluator(pickle.loads(pickled), _open)


def _evaluate(pickled: bytes, design: Design) -> dict[str, Any]:
    """Evaluates a design in a worker process, which keeps its evaluator for the next design."""
    return _evaluator(pickled).evaluate(design)
