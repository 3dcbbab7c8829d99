"""The hidden command ``thorvaldc demo``: builds robots, drives each from its generated files.

The robots are simulated in two processes.  A table shows the results of all robots.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc import __version__
from thorvaldc.cli.exits import DONE, INPUT

if TYPE_CHECKING:
    from thorvaldc.diagnostics import Report
    from thorvaldc.simulation.simulation_result import SimulationResult

PROCESSES = 2


@dataclass(frozen=True, slots=True)
class DemoOutcome:
    """The result of the simulation of one file, and the diagnostics with their source files."""

    result: SimulationResult | None
    report: Report
    sources: Mapping[str, Path]


def demo(
    files: Annotated[list[str], typer.Argument(metavar="FILE")] = [],  # noqa: B006
    output: Annotated[str, typer.Option("--output", "-o", metavar="DIR")] = "build",
) -> int:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.simulation.simulation_result import result_table

    started = time.monotonic()
    outcomes: list[DemoOutcome] = []
    for outcome in run_demo(files, output):
        outcomes.append(outcome)
        if sys.stderr.isatty():
            end = "\r" if len(outcomes) == len(files) else ""
            text = f"\r{len(outcomes)} of {len(files)}"
            print(text, end=end, file=sys.stderr, flush=True)
    statuses = [
        diagnostic_output.show_report(outcome.report, outcome.sources) for outcome in outcomes
    ]
    results = [outcome.result for outcome in outcomes if outcome.result is not None]
    if results:
        print(result_table(results, diagnostic_output.table_width()))
    built = diagnostic_output.count(len(files), "file")
    driven = diagnostic_output.count(sum(len(result.robots) for result in results), "robot")
    seconds = time.monotonic() - started
    diagnostic_output.message(f"{built} built to {output}/ and {driven} driven in {seconds:.0f} s")
    return DONE if files and all(status == DONE for status in statuses) else INPUT


def run_demo(files: Sequence[str], output: str) -> Iterator[DemoOutcome]:
    """Yields the outcomes of all robot and fleet files in their order.

    Raises ``WriteError`` if an output file cannot be written.
    """
    from thorvaldc.simulation.worker_processes import ignored_interrupts, worker_pool

    with worker_pool(min(PROCESSES, os.cpu_count() or 1)) as pool:
        with ignored_interrupts():
            outcomes = pool.map(run_job, files, [output] * len(files))
        yield from outcomes


def run_job(file: str, output: str) -> DemoOutcome:
    """Compiles a robot file, writes the generated files, and simulates the robot."""
    from thorvaldc.backends import DEFAULT_TARGETS
    from thorvaldc.compiler.output.writer import write_build
    from thorvaldc.compiler.pipeline import compile_file, emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Fleet
    from thorvaldc.simulation.simulation_run import drive_build

    report = Report()
    compilation = compile_file(file)
    result: SimulationResult | None = None
    run_report = Report()
    model = compilation.model
    if model is not None:
        emit_report = Report()
        contents = emit(model, DEFAULT_TARGETS, emit_report)
        compilation.report.extend(compilation.located(emit_report))
        folder, hashed = Path(output) / model.name, compilation.source_sha256
        write_build(contents, folder, name=model.name, source_sha256=hashed, version=__version__)
        result = drive_build(folder, run_report)
        if result is not None and isinstance(model, Fleet):
            named = (replace(r, name=f"{model.name}/{r.name}") for r in result.robots)
            result = replace(result, robots=tuple(named))
    report.extend(compilation.report)
    report.extend(compilation.located(run_report))
    return DemoOutcome(result, report, compilation.sources)
