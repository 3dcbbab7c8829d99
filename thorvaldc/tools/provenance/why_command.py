"""The command ``thorvaldc why``: explains where a value of a robot comes from."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT
from thorvaldc.cli.options import completer


@completer
def value_paths(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the names of the numbers of the robot in the argument ROBOT, part by part."""
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.model import Robot
    from thorvaldc.tools.provenance.explanation import Explainer, known_paths
    from thorvaldc.tools.provenance.value_paths import next_names

    file = Path(ctx.params["file"])
    library = [Path(name) for name in ctx.params.get("library") or ()]
    robot = compile_file(file, library=library).model
    assert isinstance(robot, Robot)  # a fleet has no values to explain
    with ExitStack() as stack:
        explainer = Explainer(file, robot, library, False, stack)
        yield from next_names(known_paths(explainer), incomplete)


def why(
    file: Annotated[str, typer.Argument(metavar="ROBOT", help="A robot.yaml.")],
    path: Annotated[
        str,
        typer.Argument(
            metavar="PATH",
            autocompletion=value_paths,
            help="A value: wheels.fl.radius, mass, modules.frame.params.width, or one in an output"
            " file, FILE:NAME or FILE:LINE.",
        ),
    ],
    json: options.Json = False,
    everything: Annotated[bool, typer.Option("--all", help="Write long lists in full.")] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import Progress, print_json, report_of, show_report
    from thorvaldc.cli.robot_file import compile_and_show
    from thorvaldc.diagnostics import DiagnosticError
    from thorvaldc.model import Robot
    from thorvaldc.model.model_json import is_model_file
    from thorvaldc.tools.provenance.explanation import MOST_COMPILATIONS, Explainer
    from thorvaldc.tools.provenance.explanation_text import ExplanationText, explanation_document

    if is_model_file(file) or Path(file).is_dir():
        raise typer.BadParameter(
            f"{file} is a build, which has no sources: give the robot file", param_hint="'ROBOT'"
        )
    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return INPUT
    if not isinstance(compilation.model, Robot):
        raise typer.BadParameter(
            f"{file} is a fleet: give the file of one of its robots", param_hint="'ROBOT'"
        )
    with ExitStack() as stack:
        explainer = Explainer(
            Path(file), compilation.model, options.library_folders(library), trust, stack
        )
        progress = Progress(MOST_COMPILATIONS, "compilations", "searching")
        explainer.probe.on_compilation = progress.show
        try:
            explanation = explainer.explain(path)
        except DiagnosticError as error:
            progress.clear()
            return show_report(report_of(error), {})
        progress.clear()
        writer = ExplanationText(
            explainer.probe.documents, compilation.files, everything=everything
        )
        if json:
            print_json(explanation_document(explanation, writer))
        else:
            sys.stdout.write(writer.text(explanation))
    return DONE
