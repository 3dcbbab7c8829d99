"""The command ``thorvaldc batch``: runs many variations of a scenario."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import message, show_report, table_width
from thorvaldc.cli.exits import DONE, INPUT, OutsideError, write_errors
from thorvaldc.diagnostics import Report

if TYPE_CHECKING:
    from thorvaldc.compiler.scenario.variations import Variations
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
    from thorvaldc.simulation.worker_processes import processors
    from thorvaldc.tools.batch import scenario_batch

    planned = _plan_runs(file, settings, draws, seed, from_document=variations or not settings)
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
        return show_report(failed_compilation.report, failed_compilation.sources)
    with write_errors(output):
        result_file = scenario_batch.ResultFile(Path(output)) if output else None
    runs = _collect_runs(planned_batch, process_count, result_file, json)
    failed_runs = [run for run in runs if run.errors]
    for run in failed_runs[:SHOWN_FAILURES]:
        for text in run.errors:
            message(f"run {run.number}: {text}")
    hidden = len(failed_runs) - SHOWN_FAILURES
    if hidden > 0:
        message(f"and {hidden} more {'run' if hidden == 1 else 'runs'}")
    return DONE if all(run.passed for run in runs) else INPUT


def _collect_runs(
    batch: Batch, process_count: int, result_file: ResultFile | None, json: bool
) -> list[Run]:
    """Runs all variations of a scenario and returns the results in the order of the run numbers.

    If an exception occurs, also Ctrl-C, the results of the completed runs are still printed and
    written.
    """
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
                print(scenario_batch.results_table(runs, table_width()))
            if len(runs) < len(batch):
                message(f"{len(runs)} of {len(batch)} runs are done")
    return runs


def _plan_runs(
    scenario: str, settings: Sequence[str], draws: str, seed: str, *, from_document: bool
) -> Variations | None:
    """Returns the variations of a scenario from the options ``--set``.

    If ``from_document`` is true, the result includes the variations in the scenario file. If the
    scenario file has errors, the function prints the errors and returns ``None``. Raises
    ``typer.BadParameter`` if an option ``--set`` is wrong or no value of the scenario varies.
    """
    from thorvaldc.compiler.scenario.variations import plan_variations

    for text in settings:
        path, equals, _ = text.partition("=")
        if not equals or not path.strip():
            raise typer.BadParameter(f"{text!r} is not PATH=VALUES", param_hint="'--set'")
    report = Report()
    variations = plan_variations(
        scenario,
        settings,
        options.parse_count(draws, "--draws", 1),
        options.parse_count(seed, "--seed", 0),
        from_document=from_document,
        report=report,
    )
    if variations is None:
        raise typer.BadParameter(f"{scenario} is no scenario", param_hint="'FILE'")
    if report.has_errors:
        show_report(report, {scenario: Path(scenario)})
        return None
    if not variations.varied and not (from_document and variations.draws > 1):
        raise typer.BadParameter(
            f"{scenario} has no `variations`; name values with --set", param_hint="'--variations'"
        )
    return variations
