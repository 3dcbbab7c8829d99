"""The command ``thorvaldc study show``: shows the results of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, OutsideError


def show_study(
    source: Annotated[
        str, typer.Argument(metavar="STUDY|DIR", help="A study file, or the folder of its results.")
    ],
    sql: Annotated[
        str,
        typer.Option("--sql", metavar="QUERY", help="Ask the table `designs` in SQL (DuckDB)."),
    ] = "",
    results: options.StudyResults = "",
    json: options.Json = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import print_json, table_width
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.text_layout import text_table
    from thorvaldc.tools.study.sample_points import MissingPackageError
    from thorvaldc.tools.study.study_runs import results_folder
    from thorvaldc.tools.study.study_table import TABLE, StudyTable
    from thorvaldc.tools.study.study_text import summary, summary_text

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
        folder = results_folder(name.value, results)
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
                print_json([dict(zip(columns, row, strict=True)) for row in rows])
            else:
                cells = [tuple("-" if v is None else str(v) for v in row) for row in rows]
                print(text_table([tuple(columns), *cells], table_width()))
        elif json:
            print_json(summary(table))
        else:
            print(summary_text(table, table_width()))
    except MissingPackageError as error:
        raise OutsideError(str(error)) from None
    except ValueError as error:
        if sql:
            raise typer.BadParameter(str(error), param_hint="'--sql'") from None
        raise OutsideError(f"{folder / TABLE} cannot be read: {error}") from None
    return DONE
