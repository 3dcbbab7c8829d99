"""The command ``thorvaldc study run``: evaluates the designs of a study."""

from __future__ import annotations

import gc
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError


def run_study(
    study: options.StudyFile,
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder of the results (default: study/NAME)."
        ),
    ] = "",
    jobs: options.Jobs = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
    scheduler: Annotated[
        str,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Evaluate on the workers of this Dask scheduler: tcp://HOST:PORT.",
        ),
    ] = "",
    json: options.Json = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import count, message, print_json, table_width
    from thorvaldc.simulation.worker_processes import processors
    from thorvaldc.tools.study.sample_points import MissingPackageError
    from thorvaldc.tools.study.study_journal import StudyBusyError, StudyJournal
    from thorvaldc.tools.study.study_progress import StudyProgress
    from thorvaldc.tools.study.study_runs import (
        open_cluster,
        parse_scheduler,
        plan_study,
        results_folder,
    )
    from thorvaldc.tools.study.study_table import TABLE, StudyTable, load_duckdb
    from thorvaldc.tools.study.study_text import summary, summary_text

    process_count = options.parse_count(jobs, "--jobs", 1) or processors()
    address = parse_scheduler(scheduler)
    gc.enable()
    try:
        load_duckdb()
    except MissingPackageError as error:
        raise OutsideError(str(error)) from None
    run = plan_study(study, library, trust)
    if run is None:
        return INPUT
    folder = results_folder(run.inputs.study.name, output)
    try:
        journal = StudyJournal(folder)
    except StudyBusyError as error:
        raise OutsideError(str(error)) from None
    run.replay(journal.results)  # the table is whole, also if there is no cluster
    total, finished = run.number, run.finished(journal.results)
    progress = StudyProgress(run)
    try:
        with open_cluster(address, run) as cluster:
            for finished in run.results(journal, process_count, cluster):
                progress.show(finished, journal.results)
    finally:
        progress.clear()
        run.write_table(journal, folder)
        journal.close()
        if finished < total:
            message(f"{finished} of {count(total, 'design')} finished; the same command continues")
    table = StudyTable.open(folder)
    if json:
        print_json(summary(table))
    else:
        print(summary_text(table, table_width()))
    message(f"wrote {folder / TABLE}")
    return DONE
