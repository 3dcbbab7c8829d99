"""The command ``thorvaldc import``: converts a configuration of the original Thorvald system."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli.diagnostic_output import show_report
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
) -> int:
    from thorvaldc.tools.importer.original_import import import_original as convert

    result = convert(Path(file))
    status = show_report(result.report, {file: Path(file)})
    if result.text is not None and output:
        _write_new_file(Path(output), result.text)
        print(output)
    elif result.text is not None:
        print(result.text, end="")
    return status


def _write_new_file(path: Path, text: str) -> None:
    from thorvaldc.diagnostics.files import write_file

    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write_file(path, text, new=True)
    except FileExistsError:
        raise OutsideError(f"will not overwrite {path}; move it away or name another") from None
