"""The results of a study as text: the best designs, the front and the counts by status."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any

from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.tools.study.design_evaluation import STATUSES
from thorvaldc.tools.study.sensitivity import (
    Interval,
    ObjectiveSensitivity,
    sensitivities,
    sensitivity_notes,
)
from thorvaldc.tools.study.study_table import StudyTable, front

MOST_ROWS = 20


def summary(table: StudyTable) -> dict[str, Any]:
    """Returns the counts by status and the best designs as JSON values.

    The designs with the status ``ok`` are ordered by the objective.  With several objectives, the
    designs of the front come first, ordered by the first objective.
    """
    description = table.description
    columns, rows = table.query("SELECT * FROM designs ORDER BY sample")
    designs = [dict(zip(columns, row, strict=True)) for row in rows]
    counts = Counter(design["status"] for design in designs)
    goals = description["objectives"]
    passed = [
        design
        for design in designs
        if design["status"] == "ok" and all(design[name] is not None for name in goals)
    ]
    points = [
        [-design[name] if goal == "maximise" else design[name] for name, goal in goals.items()]
        for design in passed
    ]
    on_front = set(front(points))
    order = sorted(range(len(passed)), key=lambda i: (i not in on_front, points[i]))
    best = [{**passed[index], "front": index in on_front} for index in order]
    result = {
        "study": description["study"],
        "designs": len(designs),
        "statuses": {status: counts[status] for status in STATUSES if counts[status]},
        "objectives": goals,
        "best": best,
    }
    shares = sensitivities(table)
    return {**result, "sensitivity": [asdict(each) for each in shares]} if shares else result


def summary_text(table: StudyTable, width: int | None) -> str:
    """Returns the counts by status and a table of the best designs.

    ``width``: number of columns of the terminal, or ``None`` for one line per design.
    """
    result, description = summary(table), table.description
    counts = ", ".join(f"{count} {status}" for status, count in result["statuses"].items())
    lines = [f"{result['study']}: {result['designs']} designs: {counts or 'none'}"]
    lines += _reasons(table, "status = 'error'" if result["best"] else "true")
    goals = result["objectives"]
    names = [*description["variables"], *description["constraints"], *goals]
    is_front = len(goals) > 1
    titles = [f"{name} ({goals[name]})" if name in goals else name for name in names]
    shown = result["best"][:MOST_ROWS]
    if shown:
        table_rows = [("sample", *titles, *(["front"] if is_front else []))]
        for design in shown:
            mark = ["*" if design["front"] else ""] if is_front else []
            cells = [cell_text(design[name]) for name in names]
            table_rows.append((str(design["sample"]), *cells, *mark))
        lines += [text_table(table_rows, width), "SI units, angles in rad"]
        if is_front:
            count = sum(1 for design in result["best"] if design["front"])
            lines.append(f"*: {count} designs that no other design surpasses in every objective")
    else:
        lines.append("no design meets every constraint and passes every scenario")
    return "\n".join(lines + _sensitivity_lines(sensitivities(table), width))


def _sensitivity_lines(shares: list[ObjectiveSensitivity], width: int | None) -> list[str]:
    lines = []
    if any(each.indices for each in shares):
        lines += ["", *text_table(sensitivity_rows(shares), width).splitlines()]
        lines.append("shares of the variance of the objective, with intervals of 95 % confidence")
    return lines + [note for each in shares for note in sensitivity_notes(each)]


def sensitivity_rows(shares: list[ObjectiveSensitivity]) -> list[tuple[str, ...]]:
    """Returns the table of indices: titles, then a row for each objective and variable.

    The variables of an objective are ordered by their total index.
    """
    table_rows: list[tuple[str, ...]] = [("objective", "variable", "alone", "with others")]
    for each in shares:
        for index in sorted(each.indices, key=lambda index: -index.total):
            first = _share(index.first_order, index.first_order_interval)
            total = _share(index.total, index.total_interval)
            table_rows.append((each.objective, index.variable, first, total))
    return table_rows


def _share(value: float, interval: Interval) -> str:
    low, high = interval
    return f"{value:.2f} ({low:.2f} to {high:.2f})"


def cell_text(value: Any) -> str:
    """Returns a value of the table for people: numbers with 4 digits, whole from 10,000 on."""
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.4g}" if abs(value) < 1e4 or abs(value) >= 1e7 else f"{value:.0f}"


def _reasons(table: StudyTable, condition: str) -> list[str]:
    """Returns the first message of each status and code of the designs with a condition in SQL."""
    _, rows = table.query(
        "SELECT status, code, min(sample), arg_min(message, sample), count(*) FROM designs"
        f" WHERE {condition} GROUP BY status, code ORDER BY 3"
    )
    return [
        f"design {sample}: {status}{f' {code}' if code else ''}: {message}"
        + (f" (and {number - 1} more)" if number > 1 else "")
        for status, code, sample, message, number in rows
    ]
