"""The command ``thorvaldc lsp``: the language server for editors."""

from __future__ import annotations

import gc
from typing import Annotated

import typer

from thorvaldc.cli.exits import DONE, OutsideError
from thorvaldc.diagnostics.installation import install_command


def lsp(
    stdio: Annotated[
        bool,
        typer.Option("--stdio", help="Use standard input and output; there is no other way."),
    ] = False,
) -> int:
    gc.enable()
    try:
        from thorvaldc.tools.language_server.server import serve
    except ImportError as error:
        if error.name is None or error.name.split(".")[0] not in ("pygls", "lsprotocol"):
            raise
        raise OutsideError(
            f"the language server needs pygls, which is not installed: {install_command('lsp')}"
        ) from None
    serve()
    return DONE
