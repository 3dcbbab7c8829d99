"""The commands ``thorvaldc study run``, ``show``, ``report`` and ``best``."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from thorvaldc.tools.study.study_definition import Objective
    from thorvaldc.tools.study.study_results import StudyTable

REPORT = "report.html"
StudyFile = Annotated[str, typer.Argument(metavar="STUDY", help="A study file.")]
StudyResults = Annotated[
    str,
    typer.Option("--results", metavar="DIR", help="Folder of the results (default: study/NAME)."),
]


def run_study(
    study: StudyFile,
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
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.simulation.worker_processes import processors
    from thorvaldc.tools.study import study_results, study_run
    from thorvaldc.tools.study.study_definition import required

    process_count = options.parse_count(jobs, "--jobs", 1) or processors()
    address = study_run.parse_scheduler(scheduler)
    gc.enable()
    run = study_run.plan_study(study, library, trust)
    if run is None:
        return INPUT
    required("duckdb")
    folder = study_results.results_folder(run.inputs.study.name, output)
    journal = study_run.StudyJournal(folder)
    run.replay(journal.results)  # the table is whole, also if there is no cluster
    total, finished = run.number, run.finished(journal.results)
    progress = study_run.StudyProgress(run)
    try:
        with study_run.open_cluster(address, run) as cluster:
            for finished in run.results(journal, process_count, cluster):
                progress.show(finished, journal.results)
    finally:
        progress.clear()
        run.write_table(journal, folder)
        journal.close()
        if finished < total:
            designs = diagnostic_output.count(total, "design")
            diagnostic_output.message(
                f"{finished} of {designs} finished; the same command continues"
            )
    table = study_results.StudyTable.open(folder)
    _print_summary(table, json)
    diagnostic_output.message(f"wrote {table.path}")
    return DONE


def _print_summary(table: StudyTable, json: bool) -> None:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.tools.study import study_results

    if json:
        diagnostic_output.print_json(study_results.summary(table))
    else:
        print(study_results.summary_text(table, diagnostic_output.table_width()))


def show_study(
    source: Annotated[
        str, typer.Argument(metavar="STUDY|DIR", help="A study file, or the folder of its results.")
    ],
    sql: Annotated[
        str,
        typer.Option("--sql", metavar="QUERY", help="Ask the table `designs` in SQL (DuckDB)."),
    ] = "",
    results: StudyResults = "",
    json: options.Json = False,
) -> int:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.text_layout import text_table
    from thorvaldc.tools.study import study_results
    from thorvaldc.tools.study.study_results import StudyTable

    folder = Path(source)
    if folder.is_dir() and results:
        raise typer.BadParameter(f"{source} is a folder of results too", param_hint="'--results'")
    if not folder.is_dir():
        document = read_file(folder, source, Report())
        name = document.get("study") if document is not None else None
        if name is None or not isinstance(name.value, str):
            raise typer.BadParameter(
                f"{source} is neither a study nor a folder", param_hint="'STUDY|DIR'"
            )
        folder = study_results.results_folder(name.value, results)
    try:
        table = StudyTable.open(folder)
    except (OSError, ValueError):
        raise OutsideError(
            f"{source}: {folder} has no results of a study; `thorvaldc study run` writes them"
        ) from None
    try:
        if sql:
            columns, rows = table.query(sql)
            if json:
                diagnostic_output.print_json([dict(zip(columns, row, strict=True)) for row in rows])
            else:
                cells = [tuple("-" if v is None else str(v) for v in row) for row in rows]
                print(text_table([tuple(columns), *cells], diagnostic_output.table_width()))
        else:
            _print_summary(table, json)
    except ValueError as error:
        if sql:
            raise typer.BadParameter(str(error), param_hint="'--sql'") from None
        raise OutsideError(f"{table.path} cannot be read: {error}") from None
    return DONE


def write_report(
    study: StudyFile,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT.html",
            help="File to write.",
            show_default=f"{REPORT} in the folder of the results",
        ),
    ] = "",
    results: StudyResults = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.cli.diagnostic_output import Progress
    from thorvaldc.diagnostics.files import write_file
    from thorvaldc.tools.study import study_report, study_results, study_run
    from thorvaldc.tools.study.study_definition import required
    from thorvaldc.tools.study.study_results import StudyTable

    if output:
        options.check_output(output, ["html", "htm"], "--output")
    run = study_run.plan_study(study, library, trust)
    if run is None:
        return INPUT
    required("plotly")
    fault = study_report.picture_fault()  # before MuJoCo is imported
    folder = study_results.results_folder(run.inputs.study.name, results)
    missing = f"the designs have no results in {folder}; `thorvaldc study run {study}` evaluates"
    try:
        table = StudyTable.open(folder)
        content = study_report.ReportContent(run.inputs.study, table, run.number)
        sensitivity = study_report.Sensitivity.of(table)
        run.replay(study_run.read_results(folder))
    except (OSError, ValueError, KeyError):
        raise OutsideError(f"{missing} them") from None
    designs = dict(zip(run.keys, run.designs, strict=True))
    keys = {design["sample"]: design["key"] for design in content.designs}
    if not keys.keys() or not all(key in designs for key in keys.values()):
        raise OutsideError(f"{missing} them: the table {table.path} is of another version")
    if fault:
        diagnostic_output.message(f"warning: the report has no pictures: {fault}")
    progress = Progress(len(content.shown) + 1, "robots")
    try:
        robots = study_report.RobotCompiler(run.inputs, draws=not fault).robots(
            [(number, designs[keys[number]]) for number in content.shown], progress.show
        )
    finally:
        progress.clear()
    path = Path(output) if output else folder / REPORT
    page = study_report.study_report(content, robots, picture_fault=fault, sensitivity=sensitivity)
    write_file(path, page)
    print(path)
    return DONE


def write_best(
    study: StudyFile,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FILE", help="The robot file to write.")
    ],
    by: Annotated[
        str,
        typer.Option("--by", metavar="OBJECTIVE", help="The objective, if the study has several."),
    ] = "",
    results: StudyResults = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.tools.study import study_results, study_run

    run = study_run.plan_study(study, library, trust)
    if run is None:
        return INPUT
    objective = _choose(run.inputs.study.objectives, by)
    folder = study_results.results_folder(run.inputs.study.name, results)
    try:
        known = study_run.read_results(folder)
    except FileNotFoundError:
        known = {}
    run.replay(known)
    finished = sum(1 for key in run.keys if key in known)
    total = max(run.number, len(run.keys))
    if finished < total:
        missing = f"{total - finished} of {total} designs have no result in {folder}"
        if not finished:
            raise OutsideError(f"{missing}; `thorvaldc study run {study}` evaluates them")
        diagnostic_output.message(f"warning: {missing}")
    winner = study_run.find_winner(run, known, objective)
    if winner is None:
        diagnostic_output.message("no design meets every constraint and passes every scenario")
        return INPUT
    text = study_run.winner_text(run, winner, objective, study)
    compilation = study_run.write_winner(Path(output), text, run)
    status = diagnostic_output.show_report(compilation.report, compilation.sources)
    if status == DONE:
        diagnostic_output.message(f"wrote {output}: design {winner.number}")
    return status


def _choose(objectives: tuple[Objective, ...], by: str) -> Objective:
    from thorvaldc.diagnostics import did_you_mean

    names = [objective.name for objective in objectives]
    if not by and len(objectives) > 1:
        raise typer.BadParameter(
            f"the study has several objectives: {', '.join(names)}", param_hint="'--by'"
        )
    for objective in objectives:
        if by in ("", objective.name):
            return objective
    hint = did_you_mean(by, names, f"it has {', '.join(names)}")
    raise typer.BadParameter(f"the study has no objective {by!r}; {hint}", param_hint="'--by'")
