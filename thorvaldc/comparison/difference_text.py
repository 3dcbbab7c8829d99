"""A comparison as text for a terminal, as Markdown for a pull request, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from thorvaldc.comparison import robot_difference
from thorvaldc.comparison.robot_difference import ABSENT, Difference, FleetDifference, ValueChange
from thorvaldc.compiler.source.node import yaml_text
from thorvaldc.diagnostics.text_layout import (
    markdown_table,
    markdown_text,
    paragraph,
    preformatted,
    text_list,
)

LONGEST_TEXT = 48
MOST_SUBJECTS = 6


_ENTRIES = "robot file"


class Row(NamedTuple):
    """A line of a comparison.

    - ``mark``: ``+`` (added), ``-`` (removed) or ``~`` (changed).
    - ``name``: names of the elements and the property.
    - ``text``: what changed, such as ``0.2 m -> 0.21 m (+5 %)``.
    """

    mark: str
    name: str
    text: str


class Section(NamedTuple):
    title: str
    rows: list[Row]


_MARKS = {robot_difference.ADDED: "+", robot_difference.REMOVED: "-", robot_difference.CHANGED: "~"}


def sections_of(difference: Difference, *, everything: bool = False) -> Iterator[Section]:
    """Yields the sections of a comparison, without empty ones.

    ``everything``: whether each derived value has a row of its own.
    """
    if isinstance(difference, FleetDifference):
        yield from _value_sections(difference.values)
        for name, robot in difference.robots:
            for section in sections_of(robot, everything=everything):
                yield Section(f"{name}: {section.title}", section.rows)
        return
    if difference.entries:
        yield Section(_ENTRIES, [_entry_row(leaf) for leaf in difference.entries])
    rows = [*_module_rows(difference.modules)]
    if rows:
        yield Section("modules", rows)
    yield from _value_sections(difference.types)
    yield from _value_sections(difference.values)
    if everything and difference.derived:
        rows = [_leaf_row(leaf) for leaf in difference.derived]
        yield Section("derived values", rows)


def headline(difference: Difference) -> str:
    """Returns the names of the two robots, or the one name that both have."""
    if difference.before == difference.after:
        return difference.after
    return f"{difference.before} -> {difference.after}"


def derived_summary(difference: robot_difference.RobotDifference) -> str:
    """Returns a sentence about the derived values, or an empty text if there are none."""
    if not difference.derived:
        return ""
    counts: dict[str, int] = {}
    for leaf in difference.derived:
        name = _group_of(leaf)
        counts[name] = counts.get(name, 0) + 1
    groups = ", ".join(f"{number} of {name}" for name, number in counts.items())
    noun = "value" if len(difference.derived) == 1 else "values"
    return f"{len(difference.derived)} derived {noun}: {groups}"


def _group_of(leaf: robot_difference.LeafDifference) -> str:
    if leaf.path[0] == "buses" and len(leaf.path) > 2:
        return f"bus {leaf.path[2]}"
    return leaf.path[0].replace("_", " ")


# -- modules ------------------------------------------------------------------------------


def _module_rows(changes: Iterable[robot_difference.ModuleChange]) -> Iterator[Row]:
    """Yields a row for each change of a module; modules with the same change share a row."""
    rows: dict[tuple[str, str], list[str]] = {}
    for change in changes:
        mark = next(
            (
                _MARKS[kind]
                for kind in (robot_difference.ADDED, robot_difference.REMOVED)
                if kind in change.kinds
            ),
            "~",
        )
        rows.setdefault((mark, _module_text(change)), []).append(change.name)
    for (mark, text), names in rows.items():
        yield Row(mark, joined(names), text)


def _module_text(change: robot_difference.ModuleChange) -> str:
    if robot_difference.ADDED in change.kinds or robot_difference.REMOVED in change.kinds:
        place = change.place if robot_difference.ADDED in change.kinds else change.old_place
        where = f"on {place}" if place else ""
        return ", ".join(filter(None, (change.type or change.old_type, where)))
    parts = []
    if robot_difference.RENAMED in change.kinds:
        parts.append(f"renamed from {change.old_name}")
    if change.old_type != change.type:
        parts.append(f"{change.old_type} -> {change.type}")
    if robot_difference.MOVED in change.kinds:
        parts.append(f"moved from {change.old_place or 'nowhere'} to {change.place or 'nowhere'}")
    parts += [f"{p.label} {change_text(p)}" for p in change.parameters]
    return "; ".join(parts) or "other links, motors, sensors or nodes"


# -- values -------------------------------------------------------------------------------


def _value_sections(values: Iterable[ValueChange]) -> Iterator[Section]:
    by_section: dict[str, list[Row]] = {}
    for change in values:
        by_section.setdefault(change.section, []).append(_value_row(change))
    # The properties of the whole robot come first; the model has some of them last.
    for title in sorted(by_section, key=lambda title: title != "robot"):
        yield Section(title, by_section[title])


def _value_row(change: ValueChange) -> Row:
    name = " ".join(filter(None, (joined(change.subjects), change.label)))
    return Row(_MARKS[change.kind], name, change_text(change))


def _leaf_row(leaf: robot_difference.LeafDifference) -> Row:
    change = ValueChange("", (), "", leaf.before, leaf.after)
    return Row(_MARKS[change.kind], leaf.text_path, change_text(change))


def _entry_row(leaf: robot_difference.LeafDifference) -> Row:
    """Returns a row with whole values as in YAML, which a unit or ``--set`` can have."""
    values = [yaml_text(v) for v in (leaf.before, leaf.after) if v is not ABSENT]
    mark = _MARKS[ValueChange("", (), "", leaf.before, leaf.after).kind]
    return Row(mark, leaf.text_path, " -> ".join(values))


def joined(names: Iterable[str]) -> str:
    """Returns names with commas, shortened if there are many."""
    names = list(dict.fromkeys(names))
    if len(names) <= MOST_SUBJECTS:
        return ", ".join(names)
    return ", ".join(names[: MOST_SUBJECTS - 1]) + f" and {len(names) - MOST_SUBJECTS + 1} more"


def change_text(change: ValueChange) -> str:
    """Returns the change of a value, such as ``0.2 m -> 0.21 m (+5 %)``."""
    if change.before is ABSENT or change.after is ABSENT:
        value = change.before if change.after is ABSENT else change.after
        if isinstance(value, dict):
            return str(value.get("type") or value.get("protocol") or value.get("role") or "")
        return value_text(value, change.unit)
    before, after = _pair(change.before, change.after, change.unit)
    return f"{before} -> {after}{_percentage(change)}"


def _pair(before: Any, after: Any, unit: str) -> tuple[str, str]:
    """Returns the texts of two values, with as many digits as are needed to tell them apart."""
    texts = ("", "")
    for digits in (4, 6, 9, 17):
        texts = value_text(before, unit, digits), value_text(after, unit, digits)
        if texts[0] != texts[1]:
            return texts
    return repr(before), repr(after)


def value_text(value: Any, unit: str, digits: int = 4) -> str:
    """Returns a value with its unit; angles in degrees, shares in percent."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        if value and all(isinstance(item, float | int) for item in value):
            numbers = ", ".join(_number(item, unit, digits) for item in value)
            return f"({numbers}) {_shown_unit(unit)}".rstrip()
        return shortened(", ".join(value_text(item, "", digits) for item in value)) or "none"
    if isinstance(value, dict):
        return shortened(", ".join(f"{k} {value_text(v, '', digits)}" for k, v in value.items()))
    if isinstance(value, int | float):
        if isinstance(value, int) and not unit:
            return str(value)
        return f"{_number(value, unit, digits)} {_shown_unit(unit)}".rstrip()
    return shortened(str(value)) or '""'


def shortened(text: str, length: int = LONGEST_TEXT) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."


def _shown_unit(unit: str) -> str:
    return {"rad": "deg", "share": "%", "J": "Wh"}.get(unit, unit)


def _number(value: float, unit: str, digits: int) -> str:
    factor = {"rad": 180.0 / math.pi, "share": 100.0, "J": 1.0 / 3600.0}.get(unit, 1.0)
    number = value * factor
    if abs(number) < 1e-12:
        return "0"
    text = f"{number:.{digits}g}"
    is_large = 1e4 <= abs(number) < 1e7 and "e" in text
    return f"{number:.0f}" if is_large else text


def _percentage(change: ValueChange) -> str:
    """Returns the relative change of a positive quantity, such as `` (+5 %)``."""
    before, after = change.before, change.after
    numbers = isinstance(before, float | int) and isinstance(after, float | int)
    if not numbers or isinstance(before, bool) or not change.unit or change.unit in ("rad", ""):
        return ""
    if before <= 0.0 or after <= 0.0 or change.unit == "share" or "position" in change.label:
        return ""
    percent = 100.0 * (after / before - 1.0)
    if abs(percent) < 0.05 or abs(percent) >= 1000.0:
        return ""
    return f" ({percent:+.{1 if abs(percent) < 10 else 0}f} %)"


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
    if section.title.endswith(_ENTRIES):  # each in one line, to be copied
        return iter(f"{name}: {text}" for name, text in rows)
    return text_list(rows, width, _LEAST_NAME, _MOST_NAME)


def difference_html(difference: Difference) -> str:
    """Returns a comparison for a notebook."""
    return preformatted(difference_text(difference))


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
    if isinstance(difference, robot_difference.RobotDifference):
        document["robot_file"] = [_leaf_document(leaf) for leaf in difference.entries]
        document["modules"] = [_module_document(change) for change in difference.modules]
        document["module_types"] = [_change_document(change) for change in difference.types]
    document["changes"] = [_change_document(change) for change in difference.values]
    document["values_of_model"] = [_leaf_document(leaf) for leaf in difference.leaves]
    if isinstance(difference, FleetDifference):
        document["robots"] = {name: difference_document(robot) for name, robot in difference.robots}
    return document


def _module_document(change: robot_difference.ModuleChange) -> dict[str, Any]:
    parameters = [_change_document(parameter) for parameter in change.parameters]
    return {**vars(change), "kinds": list(change.kinds), "parameters": parameters}


def _leaf_document(leaf: robot_difference.LeafDifference) -> dict[str, Any]:
    return {"path": leaf.text_path, **_sides(leaf.before, leaf.after)}


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
