"""The command ``thorvaldc study report``: writes the results of a study as a web page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

REPORT = "report.html"


def write_report(
    study: options.StudyFile,
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
    results: options.StudyResults = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import message
    from thorvaldc.cli.progress import Progress
    from thorvaldc.cli.run_pictures import check_output
    from thorvaldc.diagnostics.atomic_file import write_file
    from thorvaldc.tools.study.report_content import ReportContent
    from thorvaldc.tools.study.report_robots import RobotCompiler, picture_fault
    from thorvaldc.tools.study.sample_points import MissingPackageError
    from thorvaldc.tools.study.study_journal import read_results
    from thorvaldc.tools.study.study_report import Sensitivity, load_plotly_script, study_report
    from thorvaldc.tools.study.study_runs import plan_study, results_folder
    from thorvaldc.tools.study.study_table import TABLE, StudyTable

    try:
        load_plotly_script()
    except MissingPackageError as error:
        raise OutsideError(str(error)) from None
    fault = picture_fault()  # before MuJoCo is imported
    if output:
        check_output(output, ["html", "htm"], "--output")
    run = plan_study(study, library, trust)
    if run is None:
        return INPUT
    folder = results_folder(run.inputs.study.name, results)
    missing = f"the designs have no results in {folder}; `thorvaldc study run {study}` evaluates"
    try:
        table = StudyTable.open(folder)
        content = ReportContent(run.inputs.study, table, run.number)
        sensitivity = Sensitivity.of(table)
        run.replay(read_results(folder))
    except MissingPackageError as error:
        raise OutsideError(str(error)) from None
    except (OSError, ValueError, KeyError):
        raise OutsideError(f"{missing} them") from None
    designs = dict(zip(run.keys, run.designs, strict=True))
    keys = {design["sample"]: design["key"] for design in content.designs}
    if not keys.keys() or not all(key in designs for key in keys.values()):
        raise OutsideError(f"{missing} them: the table {folder / TABLE} is of another version")
    if fault:
        message(f"warning: the report has no pictures: {fault}")
    progress = Progress(len(content.shown) + 1, "robots")
    try:
        robots = RobotCompiler(run.inputs, draws=not fault).robots(
            [(number, designs[keys[number]]) for number in content.shown], progress.show
        )
    finally:
        progress.clear()
    path = Path(output) if output else folder / REPORT
    page = study_report(content, robots, picture_fault=fault, sensitivity=sensitivity)
    write_file(path, page)
    print(path)
    return DONE
