"""The report of a study: one HTML file that shows its designs without a network."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from thorvaldc import __version__
from thorvaldc.backends.templates import Templates
from thorvaldc.comparison.difference_text import Section, sections_of
from thorvaldc.comparison.module_changes import Outline, outlines_of
from thorvaldc.comparison.robot_comparison import compare_robots
from thorvaldc.compiler.pipeline import compile_robot, emit_without_model
from thorvaldc.compiler.result import SourceFile
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.model.facts.fact_page import table_html
from thorvaldc.model.facts.fact_tables import FactTable, fact_tables
from thorvaldc.model.facts.robot_facts import fact_quantity, robot_facts
from thorvaldc.simulation.pictures import PictureError, check_pillow
from thorvaldc.simulation.pictures.render import choose_opengl_backend
from thorvaldc.tools.study import study_definition as definition
from thorvaldc.tools.study import study_results
from thorvaldc.tools.study.design_evaluation import StudyInputs, robot_text
from thorvaldc.tools.study.design_text import PathError, value_text
from thorvaldc.tools.study.study_definition import Design, Study, Variable
from thorvaldc.tools.study.study_results import StudyTable

MOST_PICTURES = 20
LEAST_PICTURES = 5
"""Number of designs with pictures if the front is smaller."""

TableDesign = Mapping[str, Any]
"""A row of the table of designs."""


class ReportContent:
    """The designs of a study for its report.

    Attributes
    ----------
    planned : number of designs of the study, also those without a result.
    columns : variables, constraints and objectives, in the order of the study file, with the
        units in which people read them.
    designs : rows of the table in SI units, by number of the design.
    front : numbers of the designs that no other design surpasses in every objective.
    shown : numbers of the designs with a picture, the front first in the order of the first
        objective.
    chosen : number of the design that the report shows first: the best one, or with several
        objectives the one of the front whose normalised distance from the best values is the
        smallest.  0 if no design has the status ``ok``.
    """

    def __init__(self, study: Study, table: StudyTable, planned: int = 0) -> None:
        self.study = study
        self.planned = planned
        self.designs: Sequence[TableDesign] = table.designs()
        self.columns: list[study_results.Column] = []
        self._factors: dict[str, float] = {}
        for column in study_results.columns_of(study):
            values = (design[column.name] for design in self.designs)
            unit, self._factors[column.name] = study_results.shown_unit(column.unit, values)
            self.columns.append(replace(column, unit=unit))
        best = study_results.summary(table)["best"]
        self.front = [design["sample"] for design in best if design["front"]]
        shown = thinned([d for d in best if d["front"]], MOST_PICTURES)
        shown += best[len(self.front) :][: max(LEAST_PICTURES - len(shown), 0)]
        self.shown = [design["sample"] for design in shown]
        self.chosen = _chosen(study.objectives, shown[: len(self.front)])
        self._best = best
        self._table = table

    def statuses(self) -> list[study_results.StatusCount]:
        """Returns the counts by status and code, in the order of ``STATUSES``."""
        places = {status: place for place, status in enumerate(definition.STATUSES)}
        return sorted(
            self._table.counts(),
            key=lambda row: (places.get(row.status, len(places)), -row.count, row.code),
        )

    def value(self, design: TableDesign, column: study_results.Column) -> Any:
        """Returns a value of a design in the unit of a column of this report."""
        value = design[column.name]
        return value * self._factors[column.name] if isinstance(value, float) else value

    def axes(self, influences: Mapping[str, float]) -> tuple[str, str]:
        """Returns the names of the columns on the axes of the plot at first.

        With one objective, the first axis is the variable with the largest influence, or an empty
        text for the number of the design.  ``influences``: influence of variables on the first
        objective, for example Sobol indices; without any, their correlations with it are used.
        """
        objectives = [objective.name for objective in self.study.objectives]
        if len(objectives) > 1:
            return objectives[0], objectives[1]
        influences = influences or self._correlations(objectives[0])
        if not influences:
            return "", objectives[0]
        return max(influences, key=lambda name: influences[name]), objectives[0]

    def _correlations(self, objective: str) -> dict[str, float]:
        """Returns the absolute linear correlation of each variable with an objective."""
        correlations = {}
        for variable in self.study.variables:
            values = [design[variable.name] for design in self._best]
            if not all(isinstance(value, float) for value in values):
                continue
            try:
                correlations[variable.name] = abs(
                    statistics.correlation(values, [design[objective] for design in self._best])
                )
            except statistics.StatisticsError:  # constant, or fewer than two designs
                continue
        return correlations


def thinned(designs: Sequence[TableDesign], most: int) -> list[TableDesign]:
    """Returns at most ``most`` designs, evenly from the first to the last."""
    if len(designs) <= most:
        return list(designs)
    step = (len(designs) - 1) / (most - 1)
    return [designs[round(index * step)] for index in range(most)]


def _chosen(objectives: Sequence[definition.Objective], designs: Sequence[TableDesign]) -> int:
    if not designs:
        return 0
    ranks = [[o.rank(design[o.name]) for o in objectives] for design in designs]
    least = [min(column) for column in zip(*ranks, strict=True)]
    width = [max(column) - min(column) or 1.0 for column in zip(*ranks, strict=True)]

    def distance(index: int) -> float:
        parts = zip(ranks[index], least, width, strict=True)
        return math.hypot(*((rank - best) / size for rank, best, size in parts))

    return int(designs[min(range(len(designs)), key=distance)]["sample"])


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
        outline = outlines_of(compilation)[""]
        if number == 0:
            self._start = (robot, outline)
        differences: tuple[Section, ...] = ()
        if number and self._start is not None:
            before, before_modules = self._start
            difference = compare_robots(before, robot, before_modules, outline)
            differences = tuple(sections_of(difference))
        facts = tuple(
            replace(table, key=f"robot-{number}-{table.key}")
            for table in fact_tables(robot_facts(robot))
            if table.key not in _LONG_TABLES
        )
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


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """The table of the influence of each variable on each objective, as the report shows it.

    - ``columns``: titles of the columns.
    - ``influences``: influence of each variable on the first objective, to choose the first plot.
    - ``notes``: sentences below the table.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    influences: dict[str, float]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, table: StudyTable) -> Sensitivity | None:
        """Returns the indices of a table, or ``None`` if its study has another method."""
        shares = study_results.sensitivities(table)
        if not shares:
            return None
        columns, *rows = study_results.sensitivity_rows(shares)
        meaning = "Shares of the variance of the objective, with intervals of 95 % confidence."
        notes = [note for each in shares for note in study_results.sensitivity_notes(each)]
        influences = {index.variable: index.total for index in shares[0].indices}
        return cls(columns, tuple(rows), influences, ((meaning, *notes) if rows else tuple(notes)))


def study_report(
    content: ReportContent,
    robots: Sequence[ReportRobot],
    *,
    picture_fault: str = "",
    sensitivity: Sensitivity | None = None,
) -> str:
    """Returns the HTML document of a report.

    - ``robots``: the start robot and the robots of the designs that the report shows.
    - ``picture_fault``: why the robots have no pictures.

    Equal arguments give equal texts.  The policy of the document lets it ask no server, and runs
    no script but its own.  Raises ``MissingPackageError`` if plotly is not installed.
    """
    templates = Templates("study", escapes_html=True)
    plotly, script = (
        definition.required("plotly.offline").get_plotlyjs(),
        templates.texts["report.js"],
    )
    study, start, *designs = content.study, *robots
    return templates.render(
        "report.html",
        study=study,
        version=__version__,
        content=content,
        variables=[(v.name, _range_text(v), v.paths) for v in study.variables],
        constraints=[(c.name, _bound_text(c), c.fact) for c in study.constraints],
        objectives=[(o.name, o.goal, o.fact or o.metric) for o in study.objectives],
        start=start,
        robots=designs,
        by_number={design["sample"]: design for design in content.designs},
        value=lambda design, column: study_results.cell_text(content.value(design, column)),
        picture_fault=picture_fault,
        sensitivity=sensitivity,
        data=_script_json(_data(content, sensitivity)),
        scripts=(plotly, script),
        table_html=table_html,
        hashes=[_hash(text) for text in (plotly, script)],
    )


def _data(content: ReportContent, sensitivity: Sensitivity | None) -> dict[str, Any]:
    """Returns what the script of the report draws: the table of designs, column by column."""
    designs = content.designs
    on_front = set(content.front)
    messages = list(dict.fromkeys(design["message"] for design in designs))
    places = {message: place for place, message in enumerate(messages)}
    x, y = content.axes(sensitivity.influences if sensitivity else {})
    return {
        "samples": [design["sample"] for design in designs],
        "statuses": [design["status"] for design in designs],
        "messages": messages,
        "messageOf": [places[design["message"]] for design in designs],
        "front": [design["sample"] in on_front for design in designs],
        "columns": [
            {**asdict(column), "values": [_rounded(content.value(d, column)) for d in designs]}
            for column in content.columns
        ],
        "axes": [x, y],
        "chosen": content.chosen,
    }


def _rounded(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _script_json(value: Any) -> Any:
    """Returns JSON for a script element, in which no text can end the element."""
    from markupsafe import Markup

    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def _hash(script: str) -> str:
    """Returns the hash of a script for the Content-Security-Policy of the document."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


def _range_text(variable: Variable) -> str:
    no_break = "\N{NO-BREAK SPACE}"  # between a number and its unit
    values = [value_text(value) for value in variable.tested_values()]
    if variable.choices:
        return ", ".join(values)
    return " to ".join(value.replace(" ", no_break) for value in values)


def _bound_text(constraint: definition.Constraint) -> str:
    unit = fact_quantity(constraint.fact).unit
    bounds = (("at least", constraint.at_least), ("at most", constraint.at_most))
    return ", ".join(
        f"{words} {study_results.quantity_text(float(bound), unit)}"
        for words, bound in bounds
        if bound is not None
    )
