"""``new``: a folder with a robot.yaml to start from."""

from __future__ import annotations

import re
from pathlib import Path

import typer

from thorvaldc.cli.exits import DONE

ID = re.compile(r"[a-z][a-z0-9_]*")


def new_robot(name: str, preset: str) -> int:
    if not ID.fullmatch(name):
        raise typer.BadParameter(
            f"{name!r} is no name for a robot: small letters, digits and _, a letter first",
            param_hint="NAME",
        )
    from thorvaldc.compiler.library import data_folder

    folder = data_folder("templates") / "robot"
    presets = sorted(path.stem for path in folder.glob("*.yaml"))
    if preset not in presets:
        raise typer.BadParameter(
            f"there is no preset {preset!r}; there are {', '.join(presets)}",
            param_hint="'--preset'",
        )
    text = (folder / f"{preset}.yaml").read_text(encoding="utf-8").replace("@NAME@", name)
    file = Path(name) / "robot.yaml"
    if file.exists():
        raise typer.BadParameter(f"there is a {file} already", param_hint="NAME")
    file.parent.mkdir(exist_ok=True)
    with file.open("x", encoding="utf-8") as out:
        out.write(text)
    print(f"{file}: a {preset} robot. Next:\n  thorvaldc check {file}\n  thorvaldc build {file}")
    return DONE
