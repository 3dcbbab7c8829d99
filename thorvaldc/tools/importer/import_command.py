"""The command ``thorvaldc import``: converts a configuration of the original Thorvald system."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import DiagnosticOutput, check_format
from thorvaldc.cli.exits import OutsideError


def import_original(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="A configuration file of the original Thorvald system."
        ),
    ],
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="OUT", help="File to write.", show_default="stdout"),
    ] = "",
    format: options.Format = "text",
) -> int:
    from thorvaldc.tools.importer.original_import import import_original as convert

    check_format(format)
    if format != "text" and not output:
        raise typer.BadParameter(
            f"stdout has the diagnostics as {format}; name a file for the robot with -o",
            param_hint="'--format'",
        )
    result = convert(Path(file))
    shown = DiagnosticOutput(format, sys.stderr)
    shown.add(result.report, {file: Path(file)})
    if result.text is not None and output:
        _write_new_file(Path(output), result.text)
        shown.result(output)
    elif result.text is not None:
        print(result.text, end="")
    return shown.finish()


def _write_new_file(path: Path, text: str) -> None:
    from thorvaldc.diagnostics.files import write_file

    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write_file(path, text, new=True)
    except FileExistsError:
        raise OutsideError(f"will not overwrite {path}; move it away or name another") from None
