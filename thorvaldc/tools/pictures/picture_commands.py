"""The commands ``thorvaldc render`` and ``view``: robots to look at."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError


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
            autocompletion=options.view_names,
            help="corner, front, rear, left, right, top, or azimuth,elevation in degrees.",
        ),
    ] = "corner",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli import diagnostic_output, robot_file
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import DiagnosticError, Report
    from thorvaldc.diagnostics.files import write_file
    from thorvaldc.simulation.pictures import check_pillow
    from thorvaldc.simulation.pictures.render import choose_opengl_backend, parse_size, parse_view
    from thorvaldc.simulation.pictures.render import render as draw

    pixels = options.parsed(size, parse_size, "--size")
    camera = options.parsed(view, parse_view, "--view")
    if output:
        options.check_output(output, ["png"], "--output")
    compilation = robot_file.compile_and_show(file, library, trust=trust)
    model = compilation.model
    if model is None:
        return INPUT
    path = output or f"{model.name}.png"
    if not output:
        options.check_output(path, ["png"], "--output")
    report = Report()
    try:
        check_pillow()
        choose_opengl_backend()  # before MuJoCo is imported
        files = emit(model, ["mjcf"], report)
        picture = draw(model, files, pixels, camera)
    except DiagnosticError as error:
        report.put(error.diagnostic)
    else:
        write_file(Path(path), picture)
        print(path)
    return diagnostic_output.show_report(compilation.located(report), compilation.sources)


def view(
    file: options.ModelFile,
    html: Annotated[
        bool, typer.Option("--html", help="Write a web page even if there is a display.")
    ] = False,
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="OUT.html", help="Page to write.", show_default="<name>.html"
        ),
    ] = "",
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli import diagnostic_output, robot_file
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import DiagnosticError, Report
    from thorvaldc.diagnostics.files import write_file

    if output:
        options.check_output(output, ["html", "htm"], "--output")
    compilation = robot_file.compile_and_show(file, library, trust=trust)
    model = compilation.model
    if model is None:
        return INPUT
    if html or output or not has_display():
        # The web viewer is imported only when it is used, because it imports numpy.
        from thorvaldc.simulation.web_viewer import view_page

        path = output or f"{model.name}.html"
        options.check_output(path, ["html", "htm"], "--output")
        write_file(Path(path), view_page(model))
        print(path)
        return DONE
    report = Report()
    try:
        _open_viewer(emit(model, ["mjcf"], report))
    except DiagnosticError as error:
        report.put(error.diagnostic)
    return diagnostic_output.show_report(compilation.located(report), compilation.sources)


def has_display() -> bool:
    """Returns whether this process can probably open a window."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _open_viewer(files: dict[str, bytes]) -> None:
    from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

    scene = MujocoScene(files, visuals=True)
    import mujoco.viewer

    try:
        mujoco.viewer.launch(scene.model, scene.data)  # returns when the window is closed
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise OutsideError(f"MuJoCo's viewer does not open: {reason}; try --html") from None
