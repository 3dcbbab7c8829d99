"""Tables as text, which fit the width of a terminal without losing a character."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Sequence

GAP = "  "
LEAST_NAME = 12
"""Least width to which a column of names is shrunk; its names are broken after `_`, `/` or `.`."""
_BREAKS = re.compile(r"(?<=[_/.])(?=.)|\s+")


def text_table(
    rows: Sequence[Sequence[str]], width: int | None = None, right: Collection[int] = ()
) -> str:
    """Returns a table as text.  The first row contains the headings.

    A table that is wider than ``width`` has its headings and long cells on several lines.  Where
    the columns do not fit even so, each row becomes a paragraph of headings and cells.

    - ``width``: number of columns of the terminal, or ``None`` for one line per row.
    - ``right``: indices of the columns that are aligned to the right.
    """
    columns = list(zip(*rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    gap = GAP
    if width is not None and _total(widths, gap) > width:
        cells = [max([0, *map(len, column[1:])]) for column in columns]
        least = [min(w, _least(column)) for w, column in zip(widths, columns, strict=True)]
        if _total(least, gap) > width:
            gap = " "
        if _total(least, gap) > width:
            return "\n".join(_paragraph(rows[0], row, width) for row in rows[1:])
        # Headings take several lines before cells do.
        as_cells = [max(pair) for pair in zip(least, cells, strict=True)]
        widths = _shrunk(_shrunk(widths, as_cells, width, gap), least, width, gap)
    lines = []
    for row in rows:
        parts = [_wrapped(cell, limit) for cell, limit in zip(row, widths, strict=True)]
        for number in range(max(map(len, parts))):
            line = [part[number] if number < len(part) else "" for part in parts]
            lines.append(
                gap.join(
                    text.rjust(limit) if column in right else text.ljust(limit)
                    for column, (text, limit) in enumerate(zip(line, widths, strict=True))
                ).rstrip()
            )
    return "\n".join(lines)


def _total(widths: Sequence[int], gap: str) -> int:
    return len(gap.join(" " * width for width in widths))


def _least(column: Sequence[str]) -> int:
    """Returns the least width of a column: that of its longest part that is not broken."""
    heading = max((len(part) for part in _parts(column[0])), default=0)
    longest = 0
    for cell in column[1:]:
        if cell[:1].isdigit() or cell[:1] in ("+", "-"):  # a value and its unit stay together
            longest = max(longest, len(cell))
        else:
            longest = max([longest, *(min(len(part), LEAST_NAME) for part in cell.split())])
    return max(heading, longest)


def _shrunk(widths: Sequence[int], least: Sequence[int], width: int, gap: str) -> list[int]:
    """Returns the widths of the columns after the widest have shrunk until the table fits."""
    shrunk = list(widths)
    while _total(shrunk, gap) > width:
        wide = [i for i in range(len(shrunk)) if shrunk[i] > least[i]]
        if not wide:
            break
        shrunk[max(wide, key=lambda i: shrunk[i])] -= 1
    return shrunk


def _parts(text: str) -> list[str]:
    return [part for part in _BREAKS.split(text) if part]


def _wrapped(text: str, width: int) -> list[str]:
    """Returns the lines of a cell.  Words are kept, names are broken after `_`, `/` or `.`."""
    if len(text) <= width:
        return [text]
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) <= width:
            lines[-1] += f" {word}"
            continue
        if lines[-1]:
            lines.append("")
        for part in _parts(word):
            if len(lines[-1]) + len(part) > width and lines[-1]:
                lines.append("")
            while len(part) > width:
                lines[-1], part = part[:width], part[width:]
                lines.append("")
            lines[-1] += part
    return lines


def _paragraph(headings: Sequence[str], row: Sequence[str], width: int) -> str:
    pairs = zip(headings, row, strict=True)
    text = GAP.join(f"{heading} {cell}".strip() for heading, cell in pairs if cell)
    return textwrap.fill(
        text,
        max(width, 20),
        subsequent_indent=GAP,
        break_long_words=False,
        break_on_hyphens=False,
    )
