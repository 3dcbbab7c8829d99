"""The command ``thorvaldc render``: draws a picture of a robot or fleet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.completed_values import view_names
from thorvaldc.cli.exits import INPUT


def render(
    file: options.ModelFile,
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="OUT.png", help="File to write.", show_default="<name>.png"
        ),
    ] = "",
    size: Annotated[
        str, typer.Option("--size", metavar="WxH", help="Width and height in pixels.")
    ] = "1000x700",
    view: Annotated[
        str,
        typer.Option(
            "--view",
            metavar="VIEW",
            autocompletion=view_names,
            help="corner, front, rear, left, right, top, or azimuth,elevation in degrees.",
        ),
    ] = "corner",
    replay: Annotated[
        str,
        typer.Option("--replay", metavar="RECORD", help="Take the poses of the robots from it."),
    ] = "",
    at: Annotated[
        str,
        typer.Option(
            "--at", metavar="TIME", help="Time in the record: 5, or '5 s'.", show_default="its end"
        ),
    ] = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.compiling import compile_and_show
    from thorvaldc.cli.diagnostic_output import show_report
    from thorvaldc.cli.run_pictures import check_output, picture_errors
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import DiagnosticError, Report
    from thorvaldc.diagnostics.atomic_file import write_file
    from thorvaldc.simulation.pictures import check_pillow
    from thorvaldc.simulation.pictures.render import choose_opengl_backend, parse_size, parse_view
    from thorvaldc.simulation.pictures.render import render as draw
    from thorvaldc.tools.pictures.replays import arrangement

    with picture_errors():  # before MuJoCo is imported
        check_pillow()
        choose_opengl_backend()
    pixels = options.parsed(size, parse_size, "--size")
    camera = options.parsed(view, parse_view, "--view")
    if not replay:
        options.refuse_options({"--at": at}, "this is a time of --replay")
    time = options.parsed(at, options.parse_record_time, "--at")
    if output:
        check_output(output, ["png"], "--output")
    compilation = compile_and_show(file, library, trust=trust)
    model = compilation.model
    if model is None:
        return INPUT
    path = output or f"{model.name}.png"
    if not output:
        check_output(path, ["png"], "--output")
    arrange = None
    if replay:
        arrange = arrangement(model, replay, time)
        if arrange is None:
            return INPUT
    report = Report()
    try:
        with picture_errors():
            files = emit(model, ["mjcf"], report)
            picture = draw(model, files, pixels, camera, arrange=arrange)
    except DiagnosticError as error:
        report.put(error.diagnostic)
    else:
        write_file(Path(path), picture)
        print(path)
    return show_report(compilation.located(report), compilation.sources)
