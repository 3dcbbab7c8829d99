"""A comparison as text for a terminal, as Markdown for a pull request, and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from thorvaldc.comparison.difference_rows import (
    Section,
    derived_summary,
    headline,
    sections_of,
)
from thorvaldc.comparison.leaf_differences import ABSENT
from thorvaldc.comparison.robot_difference import (
    Difference,
    FleetDifference,
    ModuleChange,
    RobotDifference,
    ValueChange,
)
from thorvaldc.diagnostics.text_layout import (
    markdown_table,
    markdown_text,
    paragraph,
    text_list,
)

_LEAST_NAME, _MOST_NAME = 16, 34  # width of the column of marks and names
EQUAL = "no differences"


def difference_text(difference: Difference, width: int = 80, *, everything: bool = False) -> str:
    """Returns a comparison as text for a terminal with ``width`` columns.

    ``everything``: whether derived values are listed; otherwise they are counted.
    """
    if difference.is_equal:
        return f"{headline(difference)}: {EQUAL}\n"
    lines = [headline(difference)]
    for section in sections_of(difference, everything=everything):
        lines += ["", section.title, *_section_lines(section, width)]
    if not everything:
        for summary in summaries_of(difference):
            lines += ["", *paragraph(f"{summary} (--all lists them)", width)]
    return "\n".join(lines) + "\n"


def _section_lines(section: Section, width: int) -> Iterator[str]:
    rows = [(f"  {row.mark} {row.name}", row.text) for row in section.rows]
    return text_list(rows, width, _LEAST_NAME, _MOST_NAME)


def difference_markdown(difference: Difference, *, everything: bool = False) -> str:
    """Returns a comparison as Markdown, with a table for each section."""
    if difference.is_equal:
        return f"**{_markdown(headline(difference))}**: {EQUAL}\n"
    lines = [f"### {_markdown(headline(difference))}"]
    for section in sections_of(difference, everything=everything):
        rows = [("", "", "")]
        rows += [
            (_SYMBOLS[row.mark], _markdown(row.name), _markdown(row.text)) for row in section.rows
        ]
        lines += ["", f"**{_markdown(section.title)}**", "", *markdown_table(rows)]
    if not everything:
        for summary in summaries_of(difference):
            lines += ["", _markdown(summary)]
    return "\n".join(lines) + "\n"


_SYMBOLS = {"+": "added", "-": "removed", "~": "changed"}


def _markdown(text: str) -> str:
    return markdown_text(text.replace("->", "→"))


def summaries_of(difference: Difference) -> Iterator[str]:
    """Yields a sentence about the derived values of each robot."""
    if isinstance(difference, FleetDifference):
        for name, robot in difference.robots:
            summary = derived_summary(robot)
            if summary:
                yield f"{name}: {summary}"
        return
    summary = derived_summary(difference)
    if summary:
        yield summary


# -- JSON ---------------------------------------------------------------------------------


def difference_document(difference: Difference) -> dict[str, Any]:
    """Returns a comparison as a JSON document.

    The key ``values_of_model`` contains every value of the model that differs.  A value that only
    one robot has lacks the key ``before`` or ``after``.
    """
    document: dict[str, Any] = {
        "equal": difference.is_equal,
        "before": difference.before,
        "after": difference.after,
    }
    if isinstance(difference, RobotDifference):
        document["modules"] = [_module_document(change) for change in difference.modules]
        document["module_types"] = [_change_document(change) for change in difference.types]
    document["changes"] = [_change_document(change) for change in difference.values]
    document["values_of_model"] = [
        {"path": leaf.text_path, **_sides(leaf.before, leaf.after)} for leaf in difference.leaves
    ]
    if isinstance(difference, FleetDifference):
        document["robots"] = {name: difference_document(robot) for name, robot in difference.robots}
    return document


def _module_document(change: ModuleChange) -> dict[str, Any]:
    return {
        "kinds": list(change.kinds),
        "name": change.name,
        "old_name": change.old_name,
        "old_type": change.old_type,
        "type": change.type,
        "old_place": change.old_place,
        "place": change.place,
        "parameters": [_change_document(parameter) for parameter in change.parameters],
    }


def _change_document(change: ValueChange) -> dict[str, Any]:
    return {
        "section": change.section,
        "subjects": list(change.subjects),
        "label": change.label,
        "kind": change.kind,
        **_sides(change.before, change.after),
        "unit": change.unit,
    }


def _sides(before: Any, after: Any) -> dict[str, Any]:
    sides = {"before": before, "after": after}
    return {name: value for name, value in sides.items() if value is not ABSENT}
