"""The command ``thorvaldc view``: shows a robot in MuJoCo's viewer or as a web page."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError


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
    from thorvaldc.cli.compiling import compile_and_show
    from thorvaldc.cli.diagnostic_output import show_report
    from thorvaldc.cli.run_pictures import check_output
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import DiagnosticError, Report
    from thorvaldc.diagnostics.atomic_file import write_file

    if output:
        check_output(output, ["html", "htm"], "--output")
    compilation = compile_and_show(file, library, trust=trust)
    model = compilation.model
    if model is None:
        return INPUT
    if html or output or not has_display():
        # The web viewer is imported only when it is used, because it imports numpy.
        from thorvaldc.simulation.web_viewer import view_page

        path = output or f"{model.name}.html"
        check_output(path, ["html", "htm"], "--output")
        write_file(Path(path), view_page(model))
        print(path)
        return DONE
    report = Report()
    try:
        _open_viewer(emit(model, ["mjcf"], report))
    except DiagnosticError as error:
        report.put(error.diagnostic)
    return show_report(compilation.located(report), compilation.sources)


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
