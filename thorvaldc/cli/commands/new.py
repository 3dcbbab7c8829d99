"""The commands ``thorvaldc new``, which makes a folder with a robot.yaml to start from, and
``schema``, which prints the JSON Schema of a kind of YAML file for editors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli.completion import preset_names, schema_kinds
from thorvaldc.cli.exits import DONE
from thorvaldc.schema import KINDS

MODEL = "model"


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the robot and its folder.")],
    preset: Annotated[
        str,
        typer.Option(
            "--preset",
            metavar="PRESET",
            autocompletion=preset_names,
            help="4wd4ws, 2wd0ws or 1wd1ws.",
        ),
    ] = "4wd4ws",
    project: Annotated[
        bool,
        typer.Option(
            "--project", help="Make a repository: robot, own module, scenario, CI, README."
        ),
    ] = False,
) -> int:
    from thorvaldc import __version__
    from thorvaldc.compiler import scaffolding

    if not scaffolding.is_robot_name(name):
        raise typer.BadParameter(
            f"{name!r} is no name for a robot: small letters, digits and _, a letter first",
            param_hint="NAME",
        )
    if preset not in scaffolding.presets():
        raise typer.BadParameter(
            f"there is no preset {preset!r}; there are {', '.join(scaffolding.presets())}",
            param_hint="'--preset'",
        )
    files = (
        scaffolding.project_files(name, preset, __version__)
        if project
        else scaffolding.robot_files(name, preset)
    )
    try:
        scaffolding.write_new_files(Path(name), files)
    except FileExistsError as error:
        raise typer.BadParameter(f"{error} exists already", param_hint="NAME") from None
    if project:
        print(
            f"{name}: a repository with {len(files)} files. Next:\n  cd {name}\n"
            "  thorvaldc check --strict robots/*.yaml\n"
            "  thorvaldc scenario scenarios/straight.yaml"
        )
        if wheel := scaffolding.missing_wheel(files):
            print(f"CI installs a wheel of thorvaldc; build it, and commit it:\n  {wheel}")
    else:
        file = Path(name) / "robot.yaml"
        print(
            f"{file}: a {preset} robot. Next:\n  thorvaldc check {file}\n  thorvaldc build {file}"
        )
    return DONE


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            autocompletion=schema_kinds,
            help=f"{', '.join(KINDS)}; model: model.json.",
        ),
    ],
) -> int:
    from thorvaldc.model.model_json import model_schema_text
    from thorvaldc.schema import schema_text

    if kind not in (*KINDS, MODEL):
        kinds = ", ".join((*KINDS, MODEL))
        raise typer.BadParameter(f"{kind!r} is none of {kinds}", param_hint="KIND")
    print(model_schema_text() if kind == MODEL else schema_text(kind), end="")
    return DONE
