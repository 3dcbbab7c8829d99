"""``demo``: build robots, drive each from its files, print a table."""

from __future__ import annotations

import gc
import io
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.faults import Faults, count, message

if TYPE_CHECKING:
    from thorvaldc.diagnostics import Report
    from thorvaldc.simulation.run_result import SimulationResult


@dataclass
class Outcome:
    """The result of one file: its run, the diagnostics as text, and if all is well."""

    run: SimulationResult | None
    text: str
    well: bool


def run_demo(files: Sequence[str], originals: Sequence[str], output: str) -> int:
    started = time.monotonic()
    gc.enable()
    jobs = [(file, output, False) for file in files] + [(file, output, True) for file in originals]
    outcomes: list[Outcome] = []
    with multiprocessing.Pool(min(2, os.cpu_count() or 1), initializer=_deaf) as pool:
        for outcome in pool.imap(_drive, jobs):
            outcomes.append(outcome)
            _progress(len(outcomes), len(jobs))
    from thorvaldc.simulation.run_result import result_table

    for outcome in outcomes:
        if outcome.text:
            message(outcome.text.rstrip())
    runs = [outcome.run for outcome in outcomes if outcome.run is not None]
    if runs:
        print(result_table(runs))
    robots = sum(len(run.robots) for run in runs)
    seconds = time.monotonic() - started
    message(
        f"{count(len(jobs), 'file')} built to {output}/ and {count(robots, 'robot')} driven"
        f" in {seconds:.0f} s"
    )
    return DONE if jobs and all(outcome.well for outcome in outcomes) else INPUT


def _deaf() -> None:
    """Ctrl-C is for the parent, which then ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _progress(done: int, all_: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{done} of {all_}", end="\r" if done == all_ else "", file=sys.stderr, flush=True)


def _drive(job: tuple[str, str, bool]) -> Outcome:
    from thorvaldc import __version__
    from thorvaldc.backends import DEFAULT_TARGETS
    from thorvaldc.compiler.pipeline import compile_file, emit
    from thorvaldc.compiler.writer import WriteError, write_build
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Fleet
    from thorvaldc.simulation.simulation_run import drive_build

    file, output, is_original = job
    text = io.StringIO()
    faults = Faults("text", text)
    if is_original:
        file = _import(file, output, faults)
        if not file:
            return Outcome(None, text.getvalue(), False)
    done = compile_file(file)
    result: SimulationResult | None = None
    run = Report()
    if done.model is not None:
        found = Report()
        made = emit(done.model, DEFAULT_TARGETS, found)
        done.report.extend(done.located(found))
        folder = Path(output) / done.model.name
        try:
            write_build(
                made,
                folder,
                name=done.model.name,
                source_sha256=done.source_sha256,
                version=__version__,
            )
        except WriteError as fault:
            raise OutsideError(str(fault)) from None
        result = drive_build(folder, run)
        if result is not None and isinstance(done.model, Fleet):
            result = _with_fleet_name(result, done.model.name)
    done.report.extend(done.located(run))
    faults.add(done.report, done.sources)
    return Outcome(result, text.getvalue(), faults.finish() == DONE)


def _with_fleet_name(result: SimulationResult, fleet: str) -> SimulationResult:
    robots = tuple(replace(robot, name=f"{fleet}/{robot.name}") for robot in result.robots)
    return replace(result, robots=robots)


def _without_notes(report: Report) -> Report:
    """What `import` tells of each value that has no place here is not for a table."""
    from thorvaldc.diagnostics import Report, Severity

    left = Report()
    for diagnostic in report:
        if diagnostic.severity is not Severity.NOTE:
            left.put(diagnostic)
    return left


def _import(file: str, output: str, faults: Faults) -> str:
    """The robot.yaml of an original configuration; empty where there is none."""
    from thorvaldc.compiler.importer import import_original

    text, report = import_original(Path(file))
    faults.add(_without_notes(report), {file: Path(file)})
    if text is None:
        return ""
    robot = Path(output) / "imported" / f"{Path(file).stem}.yaml"
    robot.parent.mkdir(parents=True, exist_ok=True)
    robot.write_text(text, encoding="utf-8")
    return str(robot)
