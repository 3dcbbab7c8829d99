"""``import``: a configuration file of the original system as a robot.yaml."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.faults import Faults, check_format


def import_file(file: str, output: str, format: str) -> int:
    check_format(format)
    if format != "text" and not output:
        raise typer.BadParameter(
            f"stdout takes the faults as {format}; say with -o where the robot goes",
            param_hint="'--format'",
        )
    from thorvaldc.compiler.importer import import_original

    text, report = import_original(Path(file))
    faults = Faults(format, sys.stderr)
    faults.add(report, {file: Path(file)})
    if text is not None and output:
        _write_new(Path(output), text)
        faults.result(output)
    elif text is not None:
        print(text, end="")
    return faults.finish()


def _write_new(path: Path, text: str) -> None:
    try:
        with path.open("x", encoding="utf-8") as out:
            out.write(text)
    except FileExistsError:
        raise OutsideError(f"will not overwrite {path}; move it away or name another") from None
