"""The command ``thorvaldc preview``: shows a robot in a browser while its file is edited."""

from __future__ import annotations

import asyncio
import gc
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import diagnostic_output, options
from thorvaldc.cli.exits import DONE, OutsideError
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.installation import install_command


def preview(
    file: options.ModelFile,
    port: Annotated[
        str,
        typer.Option("--port", metavar="PORT", help="TCP port of the page.", show_default="free"),
    ] = "0",
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address and open no browser.")
    ] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.compiler.source.reader import read_file

    number = options.parse_port(port, "--port")
    if not Path(file).is_file():
        report = Report()
        read_file(Path(file), file, report)
        return diagnostic_output.show_report(report, {})
    folders = options.library_folders(library)
    try:
        from thorvaldc.tools.preview.compiled_robot import CompiledRobot
        from thorvaldc.tools.preview.preview_server import PreviewServer
    except ImportError as error:
        if error.name is None or error.name.split(".")[0] not in ("aiohttp", "watchfiles"):
            raise
        raise OutsideError(
            f"the preview needs {error.name}, which is not installed: {install_command('preview')}"
        ) from None
    gc.enable()
    server = PreviewServer(CompiledRobot(Path(file), folders, trust))

    def started() -> None:
        print(server.url, flush=True)
        if not no_browser:
            webbrowser.open(server.url)

    asyncio.run(server.run(number, started))
    return DONE
