"""The command ``thorvaldc info``: shows the facts about a robot or about the robots of a fleet."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import INPUT


def info(
    file: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT",
            help=options.ANY_MODEL,
        ),
    ],
    format: options.ResultFormat = "text",
    json: options.Json = False,
    everything: Annotated[
        bool, typer.Option("--all", help="List every module with the source of its mass.")
    ] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import (
        RESULT_FORMATS,
        check_format,
        print_json,
        show_report,
    )
    from thorvaldc.model import Fleet
    from thorvaldc.model.facts.robot_facts import facts_document, robot_facts
    from thorvaldc.tools.comparison.compared_inputs import read_input
    from thorvaldc.tools.comparison.facts_text import facts_markdown, facts_text

    check_format(format, RESULT_FORMATS)
    with ExitStack() as temporary:
        loaded = read_input(file, temporary, options.library_folders(library), trust=trust)
        status = show_report(loaded.report, loaded.sources)
    model = loaded.model
    if model is None:
        return status or INPUT
    if isinstance(model, Fleet):
        members = [(place.name, robot_facts(place.robot)) for place in model.placements]
        if json or format == "json":
            robots = {name: facts_document(facts) for name, facts in members}
            print_json({"name": model.name, "robots": robots})
            return status
        texts = [facts for _, facts in members]
    elif json or format == "json":
        print_json(facts_document(robot_facts(model)))
        return status
    else:
        texts = [robot_facts(model)]
    shown = (
        facts_markdown(facts) if format == "markdown" else facts_text(facts, everything=everything)
        for facts in texts
    )
    sys.stdout.write("\n".join(shown))
    return status
