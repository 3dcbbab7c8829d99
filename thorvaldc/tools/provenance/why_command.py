"""The command ``thorvaldc why``: explains where a value of a robot comes from."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT
from thorvaldc.cli.options import completer


@completer
def value_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the names of the numbers of the robot in the argument ROBOT, part by part."""
    from thorvaldc.tools.provenance.explanation import known_values
    from thorvaldc.tools.provenance.trace import Trace
    from thorvaldc.tools.provenance.value_names import next_names

    library = [Path(name) for name in ctx.params.get("library") or ()]
    trace = Trace(Path(ctx.params["file"]), library)
    numbers = [n for n, (value, *_) in known_values(trace) if isinstance(value, int | float)]
    yield from next_names(["mass", "com.x", "com.y", "com.z", *numbers], incomplete)


def why(
    file: Annotated[str, typer.Argument(metavar="ROBOT", help="A robot.yaml.")],
    path: Annotated[
        str,
        typer.Argument(
            metavar="PATH",
            autocompletion=value_names,
            help="A value: wheels.fl.radius, mass, modules.frame.params.width, or a line FILE:LINE"
            " of an output or of a document.",
        ),
    ],
    json: options.Json = False,
    everything: Annotated[bool, typer.Option("--all", help="Write long lists in full.")] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import print_json, report_of, show_report
    from thorvaldc.cli.robot_file import compile_and_show
    from thorvaldc.diagnostics import DiagnosticError
    from thorvaldc.model import Robot
    from thorvaldc.model.model_json import is_model_file
    from thorvaldc.tools.provenance.explanation import Explainer
    from thorvaldc.tools.provenance.explanation_text import explanation_text
    from thorvaldc.tools.provenance.trace import Trace

    if is_model_file(file) or Path(file).is_dir():
        raise typer.BadParameter(f"{file} is a build: give the robot file", param_hint="'ROBOT'")
    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return INPUT
    if not isinstance(compilation.model, Robot):
        raise typer.BadParameter(f"{file} is a fleet: give a robot file", param_hint="'ROBOT'")
    trace = Trace(Path(file), options.library_folders(library), trust)
    try:
        explanation = Explainer(trace).explain(path)
    except DiagnosticError as error:
        return show_report(report_of(error), {})
    if json:
        print_json(explanation)
    else:
        sys.stdout.write(explanation_text(explanation, everything=everything))
    return DONE
