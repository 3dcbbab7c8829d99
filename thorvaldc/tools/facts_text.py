"""The facts about a robot as text for a terminal and as Markdown."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence

from thorvaldc.model.facts.fact_tables import FactTable, Row, fact_tables
from thorvaldc.model.facts.robot_facts import RobotFacts

_GAP = 2  # columns between two columns of a table
_NARROWEST = 8
_LONG = ("modules", "sources")
"""Tables that the text leaves out by default, because the bill of modules sums them up."""


def facts_text(facts: RobotFacts, width: int = 80, *, everything: bool = False) -> str:
    """Returns the facts as text whose lines have at most ``width`` characters.

    ``everything``: whether the text has the tables of every module and source.
    """
    lines = [facts.name, *textwrap.wrap(facts.description, width)]
    for table in fact_tables(facts):
        if everything or table.key not in _LONG:
            lines += ["", table.title, *_table_lines(table, width)]
    return "\n".join(lines) + "\n"


def _table_lines(table: FactTable, width: int) -> Iterator[str]:
    rows = [table.columns, *table.rows] if table.columns else list(table.rows)
    indent = "  "
    widths = _column_widths(rows, width - len(indent))
    for row in rows:
        for line in _row_lines(row, widths, table.numeric):
            yield indent + line
    for note in table.notes:
        yield from textwrap.wrap(note, width, initial_indent=indent, subsequent_indent=indent)


def _column_widths(rows: Sequence[Row], width: int) -> list[int]:
    """Returns the widths of the columns, in which the widest ones are shortened to fit."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    excess = len((" " * _GAP).join("-" * each for each in widths)) - width
    while excess > 0 and max(widths) > _NARROWEST:
        widths[widths.index(max(widths))] -= 1
        excess -= 1
    return widths


def _row_lines(row: Row, widths: Sequence[int], numeric: Iterable[int]) -> Iterator[str]:
    cells = [wrapped(cell, width) for cell, width in zip(row, widths, strict=True)]
    for number in range(max(map(len, cells))):
        parts = []
        for column, (lines, width) in enumerate(zip(cells, widths, strict=True)):
            text = lines[number] if number < len(lines) else ""
            parts.append(text.rjust(width) if column in numeric else text.ljust(width))
        yield (" " * _GAP).join(parts).rstrip()


def wrapped(text: str, width: int) -> list[str]:
    """Returns a text in lines of at most ``width`` characters.

    A name that is longer than a line is broken after an underscore, a dot or a slash if possible.
    """
    if len(text) <= width:
        return [text]
    lines = [""]
    for piece in re.findall(r"[^\s_./]*[\s_./]*", text):
        while len(piece.rstrip()) > width:
            lines.append(piece[:width])
            piece = piece[width:]
        if len(lines[-1]) + len(piece.rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    return [line.rstrip() for line in lines if line.strip()] or [""]


def facts_markdown(facts: RobotFacts) -> str:
    """Returns the facts as Markdown."""
    lines = [f"# {escaped(facts.name)}"]
    if facts.description:
        lines += ["", escaped(facts.description)]
    for table in fact_tables(facts):
        lines += ["", f"## {table.title}", ""]
        columns = table.columns or ("", "")
        lines.append(_markdown_row(columns))
        rules = ("---:" if i in table.numeric else "---" for i in range(len(columns)))
        lines.append(f"| {' | '.join(rules)} |")
        lines += [_markdown_row(row) for row in table.rows]
        for note in table.notes:
            lines += ["", escaped(note)]
    return "\n".join(lines) + "\n"


def _markdown_row(row: Row) -> str:
    return f"| {' | '.join(escaped(cell.strip()) for cell in row)} |"


def escaped(text: str) -> str:
    """Returns a text in which no character but a backtick has a meaning in Markdown."""
    for character in "\\*_[]<>|#":
        text = text.replace(character, "\\" + character)
    return text.replace("\\<", "&lt;").replace("\\>", "&gt;")
