"""The command ``thorvaldc usd``: writes a robot as an OpenUSD file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import show_report


def usd(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A robot.yaml.")],
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="OUT.usda|.usdc", help="File to write.")
    ],
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.diagnostics.files import write_file
    from thorvaldc.model import Robot
    from thorvaldc.tools.usd.usd_export import export_usd

    options.check_output(output, ("usda", "usdc"), "--output")
    folders = options.library_folders(library)
    compilation = compile_file(file, library=folders, trust=trust)
    report, model = compilation.report, compilation.model
    if model is not None and not isinstance(model, Robot):
        raise typer.BadParameter(f"{file} is a fleet; name one of its robots", param_hint="'FILE'")
    data = None
    if model is not None and not report.has_errors:
        data = export_usd(model, Path(output).suffix.lower(), report)
    status = show_report(report, compilation.sources)
    if data is not None:
        write_file(Path(output), data)
        print(output)
    return status
