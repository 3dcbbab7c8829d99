"""The lines of source files that a message shows.

A terminal shows a combining mark in 0 columns and an East Asian wide character in 2 columns.  A
tab takes up to 4 terminal columns, and most other characters take 1 terminal column.  The marker
``^^^`` under a source line is therefore positioned by terminal columns, not by characters.
"""

from __future__ import annotations

import bisect
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.diagnostics.report import Span

TAB = 4
# Lines after the limit are not shown; documents are smaller, and logs can be larger.
_MAX_BYTES = 4_000_000
_MAX_LINE = 20_000  # characters
_ELLIPSIS = "…"
# Characters that could hide a part of a source line in a terminal: control characters, and marks
# that change the direction of text.
UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u200e\u200f\u202a-\u202e\u2066-\u2069]")
_LINE_BREAK = re.compile(r"\r\n|\r|\n")


@dataclass(frozen=True, slots=True)
class Excerpt:
    """The part of a source line that an error message shows, with the position of the source span.

    - ``text``: visible part of the line.
    - ``start``: terminal column at which the source span starts, from 0.
    - ``length``: length of the source span in terminal columns.
    """

    text: str
    start: int
    length: int


class Excerpts:
    """Reads the source lines for error messages.  Each source file is read from disk only once.

    - ``sources``: path of each file name in the source spans.
    - ``width``: maximum width of an output line in terminal columns.
    """

    def __init__(self, sources: Mapping[str, Path], width: int = 100) -> None:
        self._sources = sources
        self._width = width
        self._lines: dict[str, list[str]] = {}
        self._laid_out: dict[tuple[str, int], _Line | None] = {}

    def gutter(self, spans: Sequence[Span]) -> int:
        """Returns the number of terminal columns for the line numbers of the source spans."""
        return max([len(str(span.line)) for span in spans], default=1)

    def show(self, span: Span, gutter: int) -> Excerpt | None:
        """Returns the first line of a source span, or ``None`` if the line cannot be read.

        - ``gutter``: number of columns for the line numbers.
        """
        line = self._line(span)
        if line is None:
            return None
        first = min(max(span.column - 1, 0), line.length)
        last = span.end_column - 1 if span.end_line == span.line else line.stripped
        begin = line.starts[first]
        end = max(line.starts[min(max(last, first), line.length)], begin + 1)
        return _window(line, begin, end, max(self._width - gutter - 3, 20))

    def _line(self, span: Span) -> _Line | None:
        key = (span.file, span.line)
        if key not in self._laid_out:
            lines = self._file_lines(span.file)
            exists = 1 <= span.line <= len(lines) and (len(lines) > 1 or lines[0].strip())
            text = lines[span.line - 1][:_MAX_LINE] if exists else ""
            self._laid_out[key] = _lay_out(text) if exists else None
        return self._laid_out[key] if span.column <= _MAX_LINE else None

    def _file_lines(self, file: str) -> list[str]:
        if file not in self._lines:
            self._lines[file] = self._read(file)
        return self._lines[file]

    def _read(self, file: str) -> list[str]:
        path = self._sources.get(file)
        if path is None:
            return []
        try:
            data = read_bounded(path, _MAX_BYTES + 1, cut=True)
        except (OSError, ValueError):
            return []
        lines = _LINE_BREAK.split(data[:_MAX_BYTES].decode("utf-8-sig", "replace"))
        return lines[:-1] if len(data) > _MAX_BYTES and len(lines) > 1 else lines


@dataclass(frozen=True, slots=True)
class _Line:
    """The terminal column of each character of a source line.

    - ``cells``: text that the terminal shows for each character.
    - ``starts``: terminal column of each character.  The last element of ``starts`` is the terminal
      column after the last character.
    - ``stripped``: number of characters without blanks at the end of the line.
    """

    cells: list[str]
    starts: list[int]
    stripped: int

    @property
    def length(self) -> int:
        return len(self.cells)


def _lay_out(text: str) -> _Line:
    cells: list[str] = []
    starts: list[int] = []
    column = 0
    for character in text:
        shown, width = _cell(character)
        if character == "\t":
            width = TAB - column % TAB
            shown = " " * width
        cells.append(shown)
        starts.append(column)
        column += width
    starts.append(column)
    return _Line(cells, starts, len(text.rstrip()))


def _cell(character: str) -> tuple[str, int]:
    """Returns the text that a terminal shows for a character, and its width in columns."""
    if " " <= character <= "~":
        return character, 1
    if character == "\t":
        return character, TAB
    if UNPRINTABLE.match(character):
        return "\N{REPLACEMENT CHARACTER}", 1
    if unicodedata.combining(character) or unicodedata.category(character) in ("Mn", "Me", "Cf"):
        return character, 0
    return character, 2 if unicodedata.east_asian_width(character) in "WF" else 1


def _window(line: _Line, begin: int, end: int, width: int) -> Excerpt:
    """Shortens a source line to the maximum width, so that the source span stays visible.

    - ``begin``, ``end``: first terminal column of the span, and the column after the span.
    - ``width``: maximum width of the visible part in terminal columns.

        |<------------------ total ------------------>|
        aaaaaaaaaaaaaaaaaaaaXXXXXXaaaaaaaaaaaaaaaaaaaaa
                  |<------- width ------>|
                 left    begin  end    right
    shown:        …aaaaaaaaaXXXXXXaaaaaaa…
    """
    total = line.starts[-1]
    if max(total, end) <= width:
        return Excerpt("".join(line.cells).rstrip(), begin, end - begin)
    length = min(end - begin, width - 2)
    left = max(0, min(begin - (width - length) // 2, total - width + 1))
    right = left + width
    # The visible part of a source line consists of whole characters.  At each shortened end of the
    # source line, one terminal column is reserved for `…`.
    first = bisect.bisect_left(line.starts, left + (left > 0))
    last = bisect.bisect_right(line.starts, right - (right < total)) - 1
    text = "".join(line.cells[first:last]).rstrip()
    offset = line.starts[min(first, line.length)]
    before = _ELLIPSIS if left > 0 else ""
    after = _ELLIPSIS if right < total else ""
    visible = min(length, max(right - (right < total) - begin, 1))
    return Excerpt(before + text + after, begin - offset + len(before), visible)
