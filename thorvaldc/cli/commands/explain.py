"""The command ``thorvaldc explain``: shows the documentation page of a diagnostic code."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli.completed_values import diagnostic_codes
from thorvaldc.cli.exits import DONE


def explain(
    code: Annotated[
        str,
        typer.Argument(
            metavar="CODE", autocompletion=diagnostic_codes, help="TV501 or can-id-duplicate."
        ),
    ],
) -> int:
    from thorvaldc.diagnostics.explain import UnknownCode
    from thorvaldc.diagnostics.explain import explain as page_of

    try:
        print(page_of(code), end="")
    except UnknownCode as error:
        hint = f"; {error.hint}" if error.hint else ""
        raise typer.BadParameter(f"{error}{hint}", param_hint="CODE") from None
    return DONE
