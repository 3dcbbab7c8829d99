"""Renders each module of the library: ``python workshop/render_modules.py [TYPE ...]``.

The script compiles a small robot with the module, hides the rest of the robot, and writes the
picture to ``docs/assets/modules/<category>_<name>.png``, for the reference of the site.
"""

from __future__ import annotations

import dataclasses
import io
import sys
import tempfile
from pathlib import Path
from typing import Any

import yaml
from PIL import Image

from tests.conformance.test_modules import NAMES, PARTS, on_four, small_robot
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.simulation.pictures.render import View, choose_opengl_backend, render

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "assets" / "modules"
SIZE = (360, 260)


def robot_with(modules: dict[str, Any]) -> Robot:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(yaml.safe_dump({"thorvaldc": 1, "name": "small", "modules": modules}))
        model = compile_file(file).model
        assert isinstance(model, Robot), modules
        return model


def alone(name: str) -> Robot:
    """Returns a robot of which only one module of a type is visible."""
    if name == "controller/propulsion_propulsion":
        modules = small_robot("assembly/fixed_drive")
    elif name in PARTS:
        suspended = name.startswith("suspension/")
        modules = on_four({"type": f"assembly/{'suspended_' if suspended else ''}steered_drive"})
    else:
        modules = small_robot(name)
    robot = robot_with(modules)
    paths = [path for path, module in modules.items() if module["type"] == name]
    paths += [module.name for module in robot.modules if module.type == name]
    path = paths[0]
    return dataclasses.replace(
        robot,
        links=tuple(
            link if belongs(link.module, path) else dataclasses.replace(link, visuals=())
            for link in robot.links
        ),
    )


def belongs(module: str, path: str) -> bool:
    return module == path or module.startswith(f"{path}.")


def picture_of(name: str) -> bytes | None:
    """Returns the picture as PNG; ``None`` for a module without visible parts."""
    robot = alone(name)
    if not any(link.visuals for link in robot.links):
        return None
    view = View(azimuth=140.0, elevation=-22.0)
    data = render(robot, emit(robot, ["mjcf"], Report()), size=SIZE, view=view)
    with Image.open(io.BytesIO(data)) as image:
        small = image.convert("P", palette=Image.Palette.ADAPTIVE, colors=64)
    output = io.BytesIO()
    small.save(output, "PNG", optimize=True)
    return output.getvalue()


def main(names: list[str]) -> int:
    choose_opengl_backend()
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in names or NAMES:
        picture = picture_of(name)
        if picture is None:
            continue
        (FOLDER / f"{name.replace('/', '_')}.png").write_bytes(picture)
        print(f"{name}: {len(picture) // 1000} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
