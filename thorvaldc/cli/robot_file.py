"""Loads the robot of a command from a robot.yaml or from the model.json of a build."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import typer

from thorvaldc.cli.diagnostic_output import report_of, show_report
from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.installation import is_runtime_only
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.model.model_json import is_model_file, load_model


class LoadedRobot(NamedTuple):
    """The model of a robot and the source files of the robot.

    - ``sources``: maps the name of each source file to its path.
    - ``locate``: returns a report with source spans added to the diagnostics.
    """

    robot: Robot
    sources: Mapping[str, Path]
    locate: Callable[[Report], Report]

    def show(self, report: Report) -> int:
        """Prints the diagnostics of a report about the robot, and returns the exit status."""
        return show_report(self.locate(report), self.sources)


def load_robot(file: str, library: Sequence[str], trust: bool) -> LoadedRobot | None:
    """Returns the robot model from a robot.yaml or from the model.json of a build.

    A model is known by its content and may have any name.
    ``trust`` is whether xacro files of a robot.yaml are expanded without restrictions.
    If the robot file has errors, the function prints the errors and returns ``None``. Raises
    ``typer.BadParameter`` if the file contains a fleet or anything else but a robot. Raises
    ``OutsideError`` for a robot.yaml if the compiler is not installed.
    """
    # A JSON file that is no model gets the message of `load_model`.
    if is_model_file(file) or Path(file).suffix == ".json":
        return _load_model_file(Path(file))
    if is_runtime_only():
        raise OutsideError(
            f"{file} needs the compiler, and this installation is the runtime alone: give the"
            " model.json of a build"
        )
    # The compiler is imported only when it is used, because the runtime package does not contain
    # the compiler.
    from thorvaldc.cli.compiling import compile_and_show

    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return None
    if not isinstance(compilation.model, Robot):
        raise typer.BadParameter(f"{file} is no robot", param_hint="FILE")
    return LoadedRobot(compilation.model, compilation.sources, compilation.located)


def _load_model_file(path: Path) -> LoadedRobot | None:
    try:
        model = load_model(path)
    except DiagnosticError as error:
        show_report(report_of(error), {})
        return None
    if not isinstance(model, Robot):
        raise typer.BadParameter(f"{path} is no robot", param_hint="FILE")
    return LoadedRobot(model, {}, lambda report: report)
