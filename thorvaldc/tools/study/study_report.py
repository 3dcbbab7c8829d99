"""The report of a study: one HTML file that shows its designs without a network."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from thorvaldc import __version__
from thorvaldc.backends.templates import Templates
from thorvaldc.tools.study.replaced_values import value_text
from thorvaldc.tools.study.report_content import Column, ReportContent, fact_unit
from thorvaldc.tools.study.report_robots import ReportRobot
from thorvaldc.tools.study.sample_points import MissingPackageError
from thorvaldc.tools.study.sensitivity import sensitivities, sensitivity_notes
from thorvaldc.tools.study.study_definition import Constraint, Objective, Variable
from thorvaldc.tools.study.study_table import StudyTable
from thorvaldc.tools.study.study_text import cell_text, sensitivity_rows


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
        shares = sensitivities(table)
        if not shares:
            return None
        columns, *rows = sensitivity_rows(shares)
        meaning = "Shares of the variance of the objective, with intervals of 95 % confidence."
        notes = [note for each in shares for note in sensitivity_notes(each)]
        influences = {index.variable: index.total for index in shares[0].indices}
        return cls(columns, tuple(rows), influences, ((meaning, *notes) if rows else tuple(notes)))


def load_plotly_script() -> str:
    """Returns plotly.js.  Raises ``MissingPackageError`` if plotly is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise MissingPackageError("plotly") from None
    script: str = get_plotlyjs()
    return script


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
    plotly, script = load_plotly_script(), templates.texts["report.js"]
    study, start, *designs = content.study, *robots
    return templates.render(
        "report.html",
        study=study,
        version=__version__,
        content=content,
        variables=[(v.name, _range_text(v), v.paths) for v in study.variables],
        constraints=[(c.name, _bound_text(c), c.fact) for c in study.constraints],
        objectives=[(o.name, _goal_text(o), o.fact or o.metric) for o in study.objectives],
        start=start,
        robots=designs,
        by_number={design["sample"]: design for design in content.designs},
        value=value_with_unit,
        picture_fault=picture_fault,
        sensitivity=sensitivity,
        data=_script_json(_data(content, sensitivity)),
        scripts=(plotly, script),
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
            {**asdict(column), "values": [_rounded(design[column.name]) for design in designs]}
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


def value_with_unit(value: Any, column: Column) -> str:
    """Returns a value of a column as text, angles also in degrees."""
    return _quantity(value, column.unit)


def _quantity(value: Any, unit: str) -> str:
    text = cell_text(value)
    if not isinstance(value, float) or not unit:
        return text
    degrees = f" ({math.degrees(value):.1f}°)" if unit == "rad" else ""
    return f"{text} {unit}{degrees}"


def _range_text(variable: Variable) -> str:
    no_break = "\N{NO-BREAK SPACE}"  # between a number and its unit
    values = [value_text(value) for value in variable.tested_values()]
    if variable.choices:
        return ", ".join(values)
    return " to ".join(value.replace(" ", no_break) for value in values)


def _bound_text(constraint: Constraint) -> str:
    unit, bounds = fact_unit(constraint.fact), []
    if constraint.at_least is not None:
        bounds.append(f"at least {_quantity(float(constraint.at_least), unit)}")
    if constraint.at_most is not None:
        bounds.append(f"at most {_quantity(float(constraint.at_most), unit)}")
    return ", ".join(bounds)


def _goal_text(objective: Objective) -> str:
    return "maximise" if objective.maximise else "minimise"
