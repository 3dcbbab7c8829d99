"""``view``: a robot in MuJoCo's viewer, or as a web page."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.cli.compiling import compile_one
from thorvaldc.cli.exits import INPUT, OutsideError
from thorvaldc.cli.faults import Faults
from thorvaldc.cli.picturing import check_output

if TYPE_CHECKING:
    from thorvaldc.model import Fleet, Robot


def view_file(file: str, output: str, html: bool, library: Sequence[str]) -> int:
    """With ``html``, a file to write or no display: a page; else MuJoCo's viewer."""
    if output:
        check_output(output, ["html", "htm"], "--output")
    done = compile_one(file, library)
    if done.model is None:
        return INPUT
    if html or output or not has_display():
        path = output or f"{done.model.name}.html"
        check_output(path, ["html", "htm"], "--output")
        Path(path).write_text(page_of(done.model), encoding="utf-8", newline="\n")
        print(path)
        return 0
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError

    report = Report()
    try:
        _open_viewer(emit(done.model, ["mjcf"], report))
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
    faults = Faults("text", sys.stderr)
    faults.add(done.located(report), done.sources)
    return faults.finish()


def has_display() -> bool:
    """Whether a window can be opened here, as far as can be told."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def page_of(model: Robot | Fleet) -> str:
    from thorvaldc.compiler.library import data_folder
    from thorvaldc.simulation.pictures.web_page import robot_page

    template = data_folder("templates") / "view" / "page.html"
    return robot_page(model, template.read_text(encoding="utf-8"))


def _open_viewer(files: dict[str, bytes]) -> None:
    from thorvaldc.simulation.physics.mujoco_base import MujocoScene

    scene = MujocoScene(files, visuals=True)
    import mujoco.viewer

    try:
        mujoco.viewer.launch(scene.model, scene.data)  # until its window is closed
    except RuntimeError as fault:
        what = " ".join(str(fault).split())
        raise OutsideError(f"MuJoCo's viewer does not open: {what}; try --html") from None
