"""The commands ``thorvaldc study run``, ``show`` and ``best``."""

from __future__ import annotations

import gc
import json as json_text
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from pandas import DataFrame

    from thorvaldc.tools.study.study import Study

StudyFile = Annotated[
    str, typer.Argument(metavar="STUDY", help="A study file, or a Python file that makes a study.")
]
Results = Annotated[
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
    from thorvaldc.tools.study.study_results import TABLE

    process_count = options.parse_count(jobs, "--jobs", 1) or processors()
    gc.enable()
    opened = _open_study(study, library, trust)
    if opened is None:
        return INPUT
    try:
        table = opened.run(
            output, jobs=process_count, scheduler=scheduler, progress=sys.stderr.isatty()
        )
    except KeyboardInterrupt:
        diagnostic_output.message("the same command continues")
        raise
    _print_summary(table, json)
    diagnostic_output.message(f"wrote {opened.results_folder(output) / TABLE}")
    return DONE


def show_study(
    study: StudyFile,
    figures: Annotated[
        str, typer.Option("--html", metavar="OUT.html", help="Write plots as a web page (Plotly).")
    ] = "",
    results: Results = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
    json: options.Json = False,
) -> int:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.diagnostics.files import write_file
    from thorvaldc.tools.study.designs import required
    from thorvaldc.tools.study.study_figures import figures_page

    if figures:
        options.check_output(figures, ["html", "htm"], "--html")
    opened = _open_study(study, library, trust)
    if opened is None:
        return INPUT
    if figures:
        required("plotly")
    folder = opened.results_folder(results)
    table = _table(opened, study, folder)
    page = figures_page(opened, table, folder) if figures else ""
    _print_summary(table, json)
    if page:
        write_file(Path(figures), page)
        diagnostic_output.message(f"wrote {figures}")
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
    results: Results = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.compiler.source.input_file import unsaved_texts
    from thorvaldc.diagnostics.files import write_file
    from thorvaldc.tools.study.study import ROBOT_HEAD

    opened = _open_study(study, library, trust)
    if opened is None:
        return INPUT
    names = [objective.name for objective in opened.plan.objectives]
    if by not in names and (by or len(names) > 1):
        raise typer.BadParameter(f"the objectives are {', '.join(names)}", param_hint="'--by'")
    table = _table(opened, study, opened.results_folder(results))
    if len(table) < len(opened):
        diagnostic_output.message(
            f"warning: {len(opened) - len(table)} of {len(opened)} designs have no result"
        )
    best = opened.best(table, by)
    if best is None:
        diagnostic_output.message("no design meets every constraint and passes every scenario")
        return INPUT
    path = Path(output)
    if not path.parent.is_dir():
        raise OutsideError(f"there is no folder {path.parent}")
    if path.exists():
        is_robot = path.samefile(opened.plan.robot)
        text = path.read_text("utf-8", "replace") if path.is_file() and not is_robot else ""
        if not re.match(_HEADER_PATTERN, text):
            which = "which is that of the study" if is_robot else "which no study has written"
            raise OutsideError(f"will not overwrite {path}, {which}")
    values = json_text.loads(best["design"])
    lines = [f"{_HEADER}{best['sample']} of the study {opened.plan.name} ({study})"]
    lines += [f"#   {v.name}: {x}" for v, x in zip(opened.plan.variables, values, strict=True)]
    for name in (*table.attrs["constraints"], *table.attrs["objectives"]):
        lines.append(
            f"#   {name}: {best[name]:.6g} {table.attrs['objectives'].get(name, '')}".rstrip()
        )
    lines.append("# Constraints and objectives are in SI units, angles in rad.\n")
    name = f"{opened.plan.name}_{best['sample']}"
    text = "\n".join(lines) + opened.robot_text(tuple(values), name, path.parent)
    with unsaved_texts({str(path.resolve()): text.encode()}):
        compilation = compile_file(path, library=opened.plan.library, trust=trust)
    report = compilation.report
    if report.has_errors:
        return diagnostic_output.show_report(report, compilation.sources)
    # Values that are those of the study's robot file, too, are left out.
    unchanged = {
        d.span.line
        for d in report
        if d.code.name == "unit-unchanged" and d.span and Path(d.span.file) == path
    }
    head = len(lines) + ROBOT_HEAD
    rows = enumerate(text.splitlines(keepends=True), 1)
    text = "".join(row for number, row in rows if number <= head or number not in unchanged)
    write_file(path, text)
    diagnostic_output.message(f"wrote {output}: design {best['sample']}")
    return DONE


_HEADER = "# Design "
_HEADER_PATTERN = rf"{_HEADER}\d+ of the study "


def _open_study(path: str, library: list[str], trust: bool) -> Study | None:
    """Opens a study; prints its errors and returns ``None`` if it has any."""
    from thorvaldc.cli.robot_file import compile_and_show
    from thorvaldc.tools.study.study import Study, study_of_program
    from thorvaldc.tools.study.study_document import StudyPlan

    if path.endswith(".py") and Path(path).is_file():
        return study_of_program(path)
    compilation = compile_and_show(path, library, trust=trust)
    if compilation.model is None:
        return None
    if not isinstance(compilation.tool_document, StudyPlan):
        raise typer.BadParameter(f"{path} is no study", param_hint="'STUDY'")
    return Study(compilation, library=options.library_folders(library), trust=trust)


def _table(study: Study, path: str, folder: Path) -> DataFrame:
    """Reads the results of a study, in its present state."""
    from thorvaldc.tools.study.study_results import read_table

    with suppress(OSError, ValueError):
        table = read_table(folder)
        if table.attrs["identity"] == study.plan.identity():
            return table
    raise OutsideError(
        f"{folder} has no results of this state of the study; `thorvaldc study run {path}`"
        " evaluates it"
    )


def _print_summary(table: DataFrame, json: bool) -> None:
    from thorvaldc.cli import diagnostic_output
    from thorvaldc.tools.study import study_results

    if json:
        diagnostic_output.print_json(study_results.summary(table))
    else:
        print(study_results.summary_text(table, diagnostic_output.table_width()))
