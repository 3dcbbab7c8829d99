"""The command ``thorvaldc diff``: compares two robots or fleets."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import Annotated

import typer

from thorvaldc.cli.diagnostic_output import print_json, show_report
from thorvaldc.cli.exits import DONE, INPUT
from thorvaldc.cli.options import Json, Library, Trust, library_folders
from thorvaldc.tools.comparison.compared_inputs import InputKindError, compare, read_input
from thorvaldc.tools.comparison.difference_text import (
    difference_document,
    difference_markdown,
    difference_text,
)

FORMATS = ("text", "json", "markdown")


def diff(
    before: Annotated[
        str,
        typer.Argument(
            metavar="A",
            help="A robot.yaml, a fleet.yaml, a build folder, or a file of a git revision:"
            " HEAD~1:robot.yaml.",
        ),
    ],
    after: Annotated[str, typer.Argument(metavar="B", help="The robot to compare with A.")],
    format: Annotated[
        str, typer.Option("--format", metavar="text|json|markdown", help="Output format.")
    ] = "text",
    json: Json = False,
    everything: Annotated[
        bool, typer.Option("--all", help="List derived values as well, such as poses and shapes.")
    ] = False,
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="End with the exit status 1 if A and B differ.")
    ] = False,
    library: Library = [],  # noqa: B006
    trust: Trust = False,
) -> int:
    if format not in FORMATS:
        raise typer.BadParameter(
            f"{format!r} is none of {', '.join(FORMATS)}", param_hint="'--format'"
        )
    folders = library_folders(library)
    inputs = []
    with ExitStack() as temporary:
        for name in (before, after):
            compared = read_input(name, temporary, folders, trust=trust)
            status = show_report(compared.report, compared.sources)
            if compared.model is None:
                return status or INPUT
            inputs.append(compared)
    try:
        difference = compare(*inputs)
    except InputKindError as error:
        raise typer.BadParameter(str(error), param_hint="'A' / 'B'") from None
    if json or format == "json":
        print_json(difference_document(difference))
    elif format == "markdown":
        sys.stdout.write(difference_markdown(difference, everything=everything))
    else:
        sys.stdout.write(difference_text(difference, everything=everything))
    return INPUT if exit_code and not difference.is_equal else DONE
