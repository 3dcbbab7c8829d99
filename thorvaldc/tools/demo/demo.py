"""Builds robots and simulates each robot from the generated files, in two processes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from thorvaldc import __version__
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.output.writer import write_build
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet
from thorvaldc.simulation.control_loop import SimulationResult
from thorvaldc.simulation.simulation_run import drive_build
from thorvaldc.simulation.worker_processes import ignored_interrupts, worker_pool

PROCESSES = 2


@dataclass(frozen=True, slots=True)
class DemoJob:
    """The input file and the output folder of one build.

    * ``file``: a robot or fleet file.
    * ``output``: folder for the generated files.
    """

    file: str
    output: str


@dataclass(frozen=True, slots=True)
class DemoOutcome:
    """The result of the simulation of one file, and the diagnostics with their source files."""

    result: SimulationResult | None
    report: Report
    sources: Mapping[str, Path]


def run_demo(jobs: Sequence[DemoJob]) -> Iterator[DemoOutcome]:
    """Yields the outcomes of all jobs in the order of the jobs.

    Raises ``WriteError`` if an output file cannot be written.
    """
    with worker_pool(min(PROCESSES, os.cpu_count() or 1)) as pool:
        with ignored_interrupts():
            outcomes = pool.map(run_job, jobs)
        yield from outcomes


def run_job(job: DemoJob) -> DemoOutcome:
    """Compiles a robot file, writes the generated files, and simulates the robot."""
    report = Report()
    compilation = compile_file(job.file)
    result: SimulationResult | None = None
    run_report = Report()
    model = compilation.model
    if model is not None:
        emit_report = Report()
        contents = emit(model, DEFAULT_TARGETS, emit_report)
        compilation.report.extend(compilation.located(emit_report))
        folder = Path(job.output) / model.name
        write_build(
            contents,
            folder,
            name=model.name,
            source_sha256=compilation.source_sha256,
            version=__version__,
        )
        result = drive_build(folder, run_report)
        if result is not None and isinstance(model, Fleet):
            result = _with_fleet_name(result, model.name)
    report.extend(compilation.report)
    report.extend(compilation.located(run_report))
    return DemoOutcome(result, report, compilation.sources)


def _with_fleet_name(result: SimulationResult, fleet: str) -> SimulationResult:
    robots = tuple(replace(robot, name=f"{fleet}/{robot.name}") for robot in result.robots)
    return replace(result, robots=robots)
