"""The commands ``thorvaldc new``, which makes a folder with a robot.yaml to start from, and
``schema``, which prints the JSON Schema of a kind of YAML file for editors."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli.completion import preset_names, schema_kinds
from thorvaldc.cli.exits import DONE

MODEL = "model"
PRESET, NAME = "4wd4ws", "my_robot"
"""Answers to the questions of ``new`` that an empty line means."""


def new(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="Name of the robot and its folder; without it, a terminal is asked.",
        ),
    ] = "",
    preset: Annotated[
        str,
        typer.Option(
            "--preset",
            metavar="PRESET",
            autocompletion=preset_names,
            help="4wd4ws (the default), 2wd0ws or 1wd1ws.",
        ),
    ] = "",
    project: Annotated[
        bool,
        typer.Option(
            "--project", help="Make a repository: robot, own module, scenario, CI, README."
        ),
    ] = False,
) -> int:
    from thorvaldc import __version__
    from thorvaldc.compiler import scaffolding

    if not name:
        if not _is_terminal():
            raise typer.BadParameter(
                "give the robot a name: thorvaldc new my_robot", param_hint="NAME"
            )
        preset = preset or _asked("Preset", _preset_problem, _preset_question())
        name = _asked("Name of the robot and its folder", _name_problem)
    preset = preset or PRESET
    if problem := _name_problem(name):
        raise typer.BadParameter(problem, param_hint="NAME")
    if problem := _preset_problem(preset):
        raise typer.BadParameter(problem, param_hint="'--preset'")
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


def _is_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _preset_question() -> str:
    from thorvaldc.compiler import scaffolding

    presets = scaffolding.presets()
    rows = [f"  {name}  {scaffolding.description_of(name)}" for name in presets]
    return "\n".join(["Which robot do you want to start from?", *rows])


def _asked(question: str, problem_of: Callable[[str], str], text: str = "") -> str:
    """Asks until the answer has no problem, and returns it.  An empty answer means the default."""
    default = PRESET if text else NAME
    if text:
        print(text)
    while True:
        try:
            answer = input(f"{question} [{default}]: ").strip() or default
        except EOFError:
            raise typer.BadParameter("there is no answer", param_hint="NAME") from None
        problem = problem_of(answer)
        if not problem:
            return answer
        print(f"  {problem}")


def _name_problem(name: str) -> str:
    """Returns why a robot cannot have a name, or an empty text."""
    from thorvaldc.compiler import scaffolding

    if not scaffolding.is_robot_name(name):
        from thorvaldc.compiler.validation.schema_diagnostics import similar_name

        similar = similar_name(name)
        meant = f"; did you mean `{similar}`?" if similar else ""
        rule = "small letters, digits and _, a letter first"
        return f"{name!r} is no name for a robot: {rule}{meant}"
    return ""


def _preset_problem(preset: str) -> str:
    """Returns why there is no such preset, or an empty text."""
    from thorvaldc.compiler import scaffolding

    known = scaffolding.presets()
    return "" if preset in known else f"there is no preset {preset!r}; there are {', '.join(known)}"


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            autocompletion=schema_kinds,
            help="Kind of document: robot, fleet, module, scenario, ...; model: model.json.",
        ),
    ],
) -> int:
    from thorvaldc.model.model_json import model_schema_text
    from thorvaldc.schema import KINDS, schema_text

    if kind not in (*KINDS, MODEL):
        kinds = ", ".join((*KINDS, MODEL))
        raise typer.BadParameter(f"{kind!r} is none of {kinds}", param_hint="KIND")
    print(model_schema_text() if kind == MODEL else schema_text(kind), end="")
    return DONE
