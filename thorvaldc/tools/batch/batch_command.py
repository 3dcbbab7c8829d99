"""The command ``thorvaldc batch``: runs many variations of a scenario."""

from __future__ import annotations

import gc
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError, write_errors

if TYPE_CHECKING:
    from thorvaldc.tools.batch.scenario_batch import Batch, ResultFile, Run

SHOWN_FAILURES = 10
"""Largest number of failed runs whose diagnostics are printed after a batch."""


def batch(
    file: options.ScenarioFile,
    robot: options.ScenarioRobot = "",
    settings: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUES",
            autocompletion=options.scenario_variables,
            help="Replace values of the scenario: world.friction=0.3,0.6 makes a run with each"
            " value, =0.3..0.9 draws values from the range.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    variations: Annotated[
        bool, typer.Option("--variations", help="Use the `variations` of the scenario as well.")
    ] = False,
    draws: Annotated[
        str, typer.Option("--draws", metavar="N", help="Number of draws from the ranges.")
    ] = "",
    seed: Annotated[
        str, typer.Option("--seed", metavar="N", help="Seed for the draws from the ranges.")
    ] = "",
    jobs: options.Jobs = "",
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT.csv",
            help="Write the results of all runs (.csv or .json).",
        ),
    ] = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.cli.simulation_commands import plan_runs
    from thorvaldc.simulation.worker_processes import processors
    from thorvaldc.tools.batch import scenario_batch

    planned = plan_runs(file, settings, draws, seed, from_document=variations or not settings)
    if planned is None:
        return INPUT
    gc.enable()
    process_count = options.parse_count(jobs, "--jobs", 1) or processors()
    if output and Path(output).suffix.lower() not in scenario_batch.SUFFIXES:
        raise typer.BadParameter(f"{output!r} does not end in .csv or .json", param_hint="'-o'")
    planned_batch = scenario_batch.Batch(
        file, planned, robot=robot or None, library=options.library_folders(library), trust=trust
    )
    failed_compilation = planned_batch.check()
    if failed_compilation is not None:
        return diagnostic_output.show_report(failed_compilation.report, failed_compilation.sources)
    with write_errors(output):
        result_file = scenario_batch.ResultFile(Path(output)) if output else None
    runs = _collect_runs(planned_batch, process_count, result_file, json)
    failed_runs = [run for run in runs if run.errors]
    for run in failed_runs[:SHOWN_FAILURES]:
        for text in run.errors:
            diagnostic_output.message(f"run {run.number}: {text}")
    hidden = len(failed_runs) - SHOWN_FAILURES
    if hidden > 0:
        diagnostic_output.message(f"and {hidden} more {'run' if hidden == 1 else 'runs'}")
    return DONE if all(run.passed for run in runs) else INPUT


def _collect_runs(
    batch: Batch, process_count: int, result_file: ResultFile | None, json: bool
) -> list[Run]:
    """Runs all variations of a scenario and returns the results in the order of the run numbers.

    If an exception occurs, also Ctrl-C, the results of the completed runs are still printed and
    written.
    """
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.cli.diagnostic_output import Progress
    from thorvaldc.tools.batch import scenario_batch

    runs: list[Run] = []
    bar = Progress(len(batch), "runs")
    with result_file or nullcontext():
        try:
            bar.show(0)
            for run in batch.runs(process_count):
                runs.append(run)
                bar.show(len(runs))
                if result_file is not None:
                    result_file.append(run)
        except OSError:
            raise
        except RuntimeError as error:  # a process of the batch was killed
            raise OutsideError(str(error)) from None
        finally:
            bar.clear()
            runs.sort(key=lambda run: run.number)
            if json:
                print(scenario_batch.runs_as_json(runs))
            elif runs:
                print(scenario_batch.results_table(runs, diagnostic_output.table_width()))
            if len(runs) < len(batch):
                diagnostic_output.message(f"{len(runs)} of {len(batch)} runs are done")
    return runs
