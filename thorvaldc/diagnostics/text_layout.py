"""Layout of text: tables, lists and paragraphs for a terminal, and tables in Markdown.

Every command that lays out text in columns does it with these functions.  They fit the width of a
terminal without losing a character.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Iterable, Iterator, Sequence

GAP = "  "
LONGEST_WORD = 24
"""Longest word, or part of a name, that is not broken, unlike a hash."""
_BREAKS = re.compile(r"(?<=[_/.])(?=.)|\s+")


def preformatted(text: str) -> str:
    """Returns text as an HTML element, which a notebook shows."""
    from html import escape

    return f"<pre>{escape(text)}</pre>"


def text_table(
    rows: Sequence[Sequence[str]],
    width: int | None = None,
    right: Collection[int] = (),
    least: Sequence[int] = (),
) -> str:
    """Returns a table as text.  The first row contains the headings, or empty texts for a table
    without headings.

    A table that is wider than ``width`` has its headings and long cells on several lines, which
    are broken between words, or else after `_`, `/` or `.`.  Where the columns do not fit even so,
    each row becomes a paragraph of headings and cells.

    - ``width``: number of columns of the terminal, or ``None`` for one line per row.
    - ``right``: indices of the columns that are aligned to the right.
    - ``least``: least width of each column, for a table that is shown again with other cells.
    """
    columns = list(zip(*rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    widths = list(map(max, widths, least or widths))
    gap = GAP
    if width is not None and _total(widths, gap) > width:
        cells = [max([0, *map(len, column[1:])]) for column in columns]
        for words, gap in ((True, GAP), (True, " "), (False, " ")):
            fewest = [
                min(w, _least(column, words)) for w, column in zip(widths, columns, strict=True)
            ]
            if _total(fewest, gap) <= width:
                break
        else:
            return "\n".join(_paragraph(rows[0], row, width) for row in rows[1:])
        # Headings take several lines before cells do.
        as_cells = [max(pair) for pair in zip(fewest, cells, strict=True)]
        widths = _shrunk(_shrunk(widths, as_cells, width, gap), fewest, width, gap)
    lines = []
    for row in rows if any(rows[0]) else rows[1:]:
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


def _least(column: Sequence[str], words: bool) -> int:
    """Returns the least width of a column: that of its longest part that is not broken.

    ``words``: whether names are not broken.
    """
    heading = max((len(part) for part in _parts(column[0])), default=0)
    longest = 0
    for cell in column[1:]:
        if cell[:1].isdigit() or cell[:1] in ("+", "-"):  # a value and its unit stay together
            longest = max(longest, len(cell))
        else:
            parts = cell.split() if words else _parts(cell)
            longest = max([longest, *(min(len(part), LONGEST_WORD) for part in parts)])
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


# -- lists and paragraphs -----------------------------------------------------------------


def text_list(
    rows: Iterable[tuple[str, str]], width: int, least: int = 0, most: int | None = None
) -> Iterator[str]:
    """Yields the lines of a list of names, each with a text beside it.

    The texts begin in the same column, so that there is room for every name.

    - ``width``: number of columns of the terminal.
    - ``least``, ``most``: least and greatest width of the names.  A longer name has a line of its
      own.
    """
    rows = list(rows)
    column = max([least, *(len(name) for name, _ in rows)])
    column = column if most is None else min(column, most)
    indent = " " * (column + len(GAP))
    for name, text in rows:
        start = name.ljust(column) + GAP
        if len(name) > column:
            yield from textwrap.wrap(name, width, subsequent_indent=2 * GAP)
            start = indent
        if text:
            yield from _hanging(text, width, start, indent)
        elif len(name) <= column:
            yield name


def paragraph(text: str, width: int, indent: str = "") -> list[str]:
    """Returns the lines of a text in which every line begins with ``indent``."""
    return _hanging(text, width, indent, indent)


def _hanging(text: str, width: int, first: str, others: str) -> list[str]:
    return textwrap.wrap(
        text, width, initial_indent=first, subsequent_indent=others, break_on_hyphens=False
    )


# -- Markdown -----------------------------------------------------------------------------


def markdown_table(
    rows: Sequence[Sequence[str]], right: Collection[int] = (), *, aligned: bool = False
) -> Iterator[str]:
    """Yields the lines of a table in Markdown.  The first row contains the headings.

    - ``rows``: cells in Markdown, see ``markdown_text``.
    - ``right``: indices of the columns that are aligned to the right.
    - ``aligned``: whether the columns are aligned in the source too, for people who read it.
    """
    widths = [4 if column in right else 3 for column in range(len(rows[0]))]
    if aligned:
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rule = [
        "-" * (width - 1) + ":" if column in right else "-" * width
        for column, width in enumerate(widths)
    ]
    for row in (rows[0], rule, *rows[1:]):
        cells = [
            cell if not aligned else cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield f"| {' | '.join(cells)} |"


def markdown_text(text: str) -> str:
    """Returns a text in which no character has a meaning in Markdown."""
    for character in "\\`*_[]<>|#":
        text = text.replace(character, "\\" + character)
    return text.replace("\\<", "&lt;").replace("\\>", "&gt;")
