"""What the report of a study shows of its table: the columns with their units, the designs, and
which of them have a picture."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.compiler.scenario.scenario_reader import metric_units
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_unit
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.robot_facts import fact_quantity
from thorvaldc.tools.study.design_evaluation import STATUSES
from thorvaldc.tools.study.study_definition import Objective, Study, Variable
from thorvaldc.tools.study.study_table import StudyTable
from thorvaldc.tools.study.study_text import summary

MOST_PICTURES = 20
LEAST_PICTURES = 5
"""Number of designs with pictures if the front is smaller."""

TableDesign = Mapping[str, Any]
"""A row of the table of designs."""


@dataclass(frozen=True, slots=True)
class Column:
    """A variable, constraint or objective.

    - ``kind``: ``variable``, ``constraint`` or ``objective``.
    - ``unit``: SI unit, or empty if it is unknown or 1.
    - ``goal``: ``minimise``, ``maximise``, or empty.
    """

    name: str
    kind: str
    unit: str
    goal: str = ""

    @property
    def title(self) -> str:
        """The name with the unit, such as ``energy (J)``."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


@dataclass(frozen=True, slots=True)
class StatusCount:
    """Number of the designs with a status and a code, and the first of them with its message."""

    status: str
    code: str
    count: int
    sample: int
    message: str


class ReportContent:
    """The designs of a study for its report.

    Attributes
    ----------
    planned : number of designs of the study, also those without a result.
    columns : variables, constraints and objectives, in the order of the study file.
    designs : rows of the table, by number of the design.
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
        self.columns = list(_columns(study))
        names, rows = table.query("SELECT * FROM designs ORDER BY sample")
        self.designs: list[TableDesign] = [dict(zip(names, row, strict=True)) for row in rows]
        best = summary(table)["best"]
        self.front = [design["sample"] for design in best if design["front"]]
        shown = thinned([d for d in best if d["front"]], MOST_PICTURES)
        shown += best[len(self.front) :][: max(LEAST_PICTURES - len(shown), 0)]
        self.shown = [design["sample"] for design in shown]
        self.chosen = _chosen(study.objectives, shown[: len(self.front)])
        self._best = best

    def statuses(self) -> list[StatusCount]:
        """Returns the counts by status and code, in the order of ``STATUSES``."""
        counts = Counter((design["status"], design["code"]) for design in self.designs)
        first: dict[tuple[str, str], TableDesign] = {}
        for design in self.designs:
            first.setdefault((design["status"], design["code"]), design)
        places = {status: place for place, status in enumerate(STATUSES)}
        order = sorted(
            counts, key=lambda key: (places.get(key[0], len(places)), -counts[key], key[1])
        )
        return [
            StatusCount(*key, counts[key], first[key]["sample"], first[key]["message"])
            for key in order
        ]

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


def _chosen(objectives: Sequence[Objective], designs: Sequence[TableDesign]) -> int:
    if not designs:
        return 0
    ranks = [[o.rank(design[o.name]) for o in objectives] for design in designs]
    least = [min(column) for column in zip(*ranks, strict=True)]
    width = [max(column) - min(column) or 1.0 for column in zip(*ranks, strict=True)]

    def distance(index: int) -> float:
        parts = zip(ranks[index], least, width, strict=True)
        return math.hypot(*((rank - best) / size for rank, best, size in parts))

    return int(designs[min(range(len(designs)), key=distance)]["sample"])


def _columns(study: Study) -> list[Column]:
    columns = [Column(v.name, "variable", variable_unit(v)) for v in study.variables]
    columns += [Column(c.name, "constraint", fact_unit(c.fact)) for c in study.constraints]
    return columns + objective_columns(study)


def objective_columns(study: Study) -> list[Column]:
    """Returns the columns of the objectives of a study."""
    columns = []
    for objective in study.objectives:
        metric = objective.metric.rpartition(".")[2]
        unit = fact_unit(objective.fact) if objective.fact else metric_units()[metric]
        goal = "maximise" if objective.maximise else "minimise"
        columns.append(Column(objective.name, "objective", unit, goal))
    return columns


def fact_unit(fact: str) -> str:
    """Returns the SI unit of a fact with a dotted path, or an empty text.

    The currency of a price is in the facts of the robots.
    """
    return fact_quantity(fact).unit


def variable_unit(variable: Variable) -> str:
    """Returns the SI unit of the values of a variable, or an empty text."""
    unit = variable.unit
    if variable.choices:
        units = {str(choice).lstrip("+-.0123456789eE").strip() for choice in variable.choices}
        unit = units.pop() if len(units) == 1 else ""
    try:
        dimension = parse_unit(unit).dimension if unit else ()
    except UnitError:
        return ""
    for quantity in QUANTITIES.values():
        if dimension == quantity.dimensions[0]:
            return si.unit_of(quantity.name)
    return ""
