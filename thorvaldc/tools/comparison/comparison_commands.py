"""The commands ``thorvaldc diff`` and ``info``: two robots compared, and the facts of one."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import diagnostic_output, options
from thorvaldc.cli.exits import DONE, INPUT
from thorvaldc.cli.options import check_output

ANY_MODEL = (
    "A robot.yaml, a fleet.yaml, a build folder, or a file of a git revision: HEAD~1:robot.yaml."
)
FORMATS = ("text", "json", "markdown")


def diff(
    before: Annotated[
        str,
        typer.Argument(metavar="A", help=ANY_MODEL),
    ],
    after: Annotated[str, typer.Argument(metavar="B", help="The robot to compare with A.")],
    format: Annotated[
        str, typer.Option("--format", metavar="text|json|markdown", help="Output format.")
    ] = "text",
    json: options.Json = False,
    everything: Annotated[
        bool, typer.Option("--all", help="List derived values as well, such as poses and shapes.")
    ] = False,
    html: Annotated[
        str,
        typer.Option("--html", metavar="OUT.html", help="Write a page that shows both robots."),
    ] = "",
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="End with the exit status 1 if A and B differ.")
    ] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.comparison import difference_text
    from thorvaldc.comparison.module_changes import outlines_of
    from thorvaldc.comparison.robot_comparison import compare_models
    from thorvaldc.diagnostics.files import write_file
    from thorvaldc.model import Fleet
    from thorvaldc.tools.comparison import compared_inputs, comparison_output
    from thorvaldc.tools.comparison.robot_file_entries import with_entries

    diagnostic_output.check_format(format, FORMATS)
    if html:
        check_output(html, ["html", "htm"], "--html")
    folders = options.library_folders(library)
    compilations = []
    with ExitStack() as temporary:
        for name in (before, after):
            compared = compared_inputs.read_input(name, temporary, folders, trust=trust)
            status = diagnostic_output.show_report(compared.report, compared.sources)
            if compared.model is None:
                hint = compared_inputs.revision_hint(before, after)
                if hint is not None:
                    diagnostic_output.message(f"hint: {hint}")
                return status or INPUT
            compilations.append(compared)
    models = [compilation.model for compilation in compilations if compilation.model is not None]
    difference = compare_models(models[0], models[1], [outlines_of(c) for c in compilations])
    if difference is None:
        kinds = [
            f"{name} is a {'fleet' if isinstance(model, Fleet) else 'robot'}"
            for name, model in zip((before, after), models, strict=True)
        ]
        raise typer.BadParameter(" and ".join(kinds), param_hint="'A' / 'B'")
    difference = with_entries(difference, *compilations)
    if html:
        write_file(Path(html), comparison_output.difference_page(difference, *models))
        diagnostic_output.message(html)
    if json or format == "json":
        diagnostic_output.print_json(difference_text.difference_document(difference))
    elif format == "markdown":
        sys.stdout.write(difference_text.difference_markdown(difference, everything=everything))
    else:
        sys.stdout.write(difference_text.difference_text(difference, everything=everything))
    return INPUT if exit_code and not difference.is_equal else DONE


def info(
    file: Annotated[
        str,
        typer.Argument(metavar="ROBOT", help=ANY_MODEL),
    ],
    json: options.Json = False,
    everything: Annotated[
        bool, typer.Option("--all", help="List every module with the source of its mass.")
    ] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.model import Fleet
    from thorvaldc.model.facts.robot_facts import facts_document, robot_facts
    from thorvaldc.tools.comparison.compared_inputs import read_input
    from thorvaldc.tools.comparison.comparison_output import facts_text

    with ExitStack() as temporary:
        loaded = read_input(file, temporary, options.library_folders(library), trust=trust)
        status = diagnostic_output.show_errors(loaded.report, loaded.sources, file)
    model = loaded.model
    if model is None:
        return status or INPUT
    if isinstance(model, Fleet):
        facts = {place.name: robot_facts(place.robot) for place in model.placements}
    else:
        facts = {"": robot_facts(model)}
    if json:
        documents = {name: facts_document(each) for name, each in facts.items()}
        document = documents.get("") or {"name": model.name, "robots": documents}
        diagnostic_output.print_json(document)
    else:
        texts = (facts_text(each, everything=everything) for each in facts.values())
        sys.stdout.write("\n".join(texts))
    return status
