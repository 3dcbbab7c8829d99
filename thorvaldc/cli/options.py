"""Options that many commands have."""

from __future__ import annotations

from typing import Annotated

import typer

Format = Annotated[
    str, typer.Option("--format", metavar="text|json|github|sarif", help="How faults are shown.")
]
Library = Annotated[
    list[str],
    typer.Option("--library", metavar="DIR", help="A folder of modules of yours; may be repeated."),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
