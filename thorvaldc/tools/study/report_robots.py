"""The robots in the report of a study: picture, facts, and the differences from the start robot."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from thorvaldc.comparison.difference_rows import Section, sections_of
from thorvaldc.comparison.module_outline import Outline, outline_of_file
from thorvaldc.comparison.robot_comparison import compare_robots
from thorvaldc.compiler.pipeline import compile_robot, emit_without_model
from thorvaldc.compiler.result import SourceFile
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.model.facts.fact_tables import FactTable, fact_tables
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.simulation.pictures import PictureError, check_pillow
from thorvaldc.simulation.pictures.render import choose_opengl_backend
from thorvaldc.tools.study.design_evaluation import StudyInputs, robot_text
from thorvaldc.tools.study.replaced_values import PathError
from thorvaldc.tools.study.sample_points import Design

PICTURE_SIZE = (480, 336)  # pixels
_LONG_TABLES = ("modules", "sources")  # hundreds of rows; the bill of modules sums them up


@dataclass(frozen=True, slots=True)
class ReportRobot:
    """A robot in a report.

    - ``number``: number of the design, or 0 for the start robot.
    - ``picture``: PNG as a ``data:`` address, or empty without OpenGL.
    - ``differences``: tables of the differences from the start robot.
    - ``error``: why the robot cannot be compiled, or empty.
    """

    number: int
    picture: str = ""
    facts: tuple[FactTable, ...] = ()
    differences: tuple[Section, ...] = ()
    error: str = ""


def picture_fault() -> str:
    """Returns why this computer draws no pictures, or an empty text if it does.

    Call it before MuJoCo is imported, if possible.
    """
    try:
        check_pillow()
        choose_opengl_backend()
    except PictureError as error:
        return str(error)
    return ""


class RobotCompiler:
    """Compiles robots of a study for its report.

    ``draws``: whether the robots have pictures.
    """

    def __init__(self, inputs: StudyInputs, *, draws: bool) -> None:
        self._inputs = inputs
        self._draws = draws
        self._start: tuple[Robot, Outline] | None = None

    def robots(
        self, designs: Sequence[tuple[int, Design]], progress: Callable[[int], None]
    ) -> list[ReportRobot]:
        """Returns the start robot and the robots of designs with their numbers.

        ``progress`` gets the number of finished robots.  A robot that cannot be compiled has an
        error instead of a picture and facts.
        """
        robots = [self._robot(0, self._inputs.text)]
        for number, design in designs:
            progress(len(robots))
            try:
                robots.append(self._robot(number, robot_text(self._inputs, design)))
            except PathError as error:
                robots.append(ReportRobot(number, error=str(error)))
        return robots

    def _robot(self, number: int, text: str) -> ReportRobot:
        path, library = self._inputs.study.robot, self._inputs.library
        with unsaved_texts({os.path.realpath(path): text.encode()}):
            source = SourceFile(path, path.name, path.parent)
            compilation = compile_robot(source, library, self._inputs.trust)
            robot = compilation.model
            if not isinstance(robot, Robot):
                return ReportRobot(number, error=compilation.report.errors[0].message)
            outline = outline_of_file(path, library, robot)
        if number == 0:
            self._start = (robot, outline)
        differences: tuple[Section, ...] = ()
        if number and self._start is not None:
            before, before_modules = self._start
            difference = compare_robots(before, robot, before_modules, outline)
            differences = tuple(sections_of(difference))
        facts = tuple(t for t in fact_tables(robot_facts(robot)) if t.key not in _LONG_TABLES)
        return ReportRobot(number, self._picture(robot), facts, differences)

    def _picture(self, robot: Robot) -> str:
        if not self._draws:
            return ""
        from thorvaldc.simulation.pictures.render import render

        try:
            files = emit_without_model(robot, ["mjcf"], Report())
            picture = render(robot, files, PICTURE_SIZE)
        except (DiagnosticError, PictureError):
            return ""  # facts without a picture are better than no report
        return "data:image/png;base64," + base64.b64encode(picture).decode("ascii")
