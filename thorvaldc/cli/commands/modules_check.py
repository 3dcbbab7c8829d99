"""The command ``thorvaldc modules check``: reports every error in the modules of library
folders."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options


def check_modules(
    folders: Annotated[
        list[str],
        typer.Argument(metavar="[DIR]...", help="Library folders.", show_default="the project's"),
    ] = [],  # noqa: B006
    format: options.Format = "text",
    strict: options.Strict = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import DiagnosticOutput, check_format, count
    from thorvaldc.compiler.catalogue import check_library

    check_format(format)
    output = DiagnosticOutput(format, sys.stdout)
    paths: list[Path | None] = [*options.library_folders(folders, "DIR")]
    for folder in paths or [None]:
        result = check_library(folder)
        output.add(result.report, result.sources)
        output.result(f"{folder or 'modules'}: {count(len(result.names), 'module')}")
    return output.finish(strict)
