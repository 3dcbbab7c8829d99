"""The command ``thorvaldc schema``: prints the JSON Schema of a kind of YAML file, such as a
robot."""

from __future__ import annotations

from typing import Annotated

import typer

from thorvaldc.cli.completed_values import schema_kinds
from thorvaldc.cli.exits import DONE
from thorvaldc.schema.documents import KINDS

MODEL = "model"


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            autocompletion=schema_kinds,
            help=f"{', '.join(KINDS)}; model: model.json.",
        ),
    ],
) -> int:
    from thorvaldc.model.model_json import model_schema_text
    from thorvaldc.schema.documents import schema_text

    if kind not in (*KINDS, MODEL):
        kinds = ", ".join((*KINDS, MODEL))
        raise typer.BadParameter(f"{kind!r} is none of {kinds}", param_hint="KIND")
    print(model_schema_text() if kind == MODEL else schema_text(kind), end="")
    return DONE
