"""Runs all variations of a scenario for the command ``batch``."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import typer

from thorvaldc.cli.diagnostic_output import message, show_report, table_width
from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.options import library_folders, parse_count
from thorvaldc.cli.progress import Progress
from thorvaldc.compiler.scenario.variations import Variations
from thorvaldc.simulation.worker_processes import processors
from thorvaldc.tools.batch.batch_results import SUFFIXES, ResultFile, results_table, runs_as_json
from thorvaldc.tools.batch.scenario_batch import Batch, Run

SHOWN_FAILURES = 10
"""Largest number of failed runs whose diagnostics are printed after a batch."""


def run_batch(
    scenario: str,
    variations: Variations,
    robot: str | None,
    library: Sequence[str],
    *,
    trust: bool,
    jobs: str,
    output: str,
    json: bool,
) -> int:
    """Runs all variations of a scenario, prints the results and returns the exit status.

    After Ctrl-C, the results of the completed runs are printed and written.

    - ``output``: path of a CSV or JSON file for the results, or empty for no file.
    """
    gc.enable()
    process_count = parse_count(jobs, "--jobs", 1) or processors()
    path = Path(output)
    if output and path.suffix.lower() not in SUFFIXES:
        raise typer.BadParameter(f"{output!r} does not end in .csv or .json", param_hint="'-o'")
    batch = Batch(scenario, variations, robot=robot, library=library_folders(library), trust=trust)
    failed_compilation = batch.check()
    if failed_compilation is not None:
        return show_report(failed_compilation.report, failed_compilation.sources)
    runs = _collect_runs(batch, process_count, path if output else None, json)
    failed_runs = [run for run in runs if run.errors]
    for run in failed_runs[:SHOWN_FAILURES]:
        for text in run.errors:
            message(f"run {run.number}: {text}")
    hidden = len(failed_runs) - SHOWN_FAILURES
    if hidden > 0:
        message(f"and {hidden} more {'run' if hidden == 1 else 'runs'}")
    return DONE if all(run.passed for run in runs) else INPUT


def _collect_runs(batch: Batch, process_count: int, output: Path | None, json: bool) -> list[Run]:
    """Runs all variations of a scenario and returns the results in the order of the run numbers.

    If an exception occurs, the results of the completed runs are still printed and written.
    """
    runs: list[Run] = []
    bar = Progress(len(batch), "runs")
    with ExitStack() as stack:
        result_file = stack.enter_context(_open_results(output)) if output is not None else None
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
                print(runs_as_json(runs))
            elif runs:
                print(results_table(runs, table_width()))
            if len(runs) < len(batch):
                message(f"{len(runs)} of {len(batch)} runs are done")
    return runs


def _open_results(path: Path) -> ResultFile:
    try:
        return ResultFile(path)
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror or error}") from None
