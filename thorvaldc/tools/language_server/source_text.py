"""Positions in a text, in the units of the Language Server Protocol and of source spans.

A source span counts lines and Unicode characters from 1.  The protocol counts lines from 0, and
columns in UTF-16 code units from 0: a character above U+FFFF has two code units.
"""

from __future__ import annotations

import bisect
import re

from lsprotocol.types import Position, Range

from thorvaldc.diagnostics import Span

_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n|\Z)")


class SourceText:
    """The text of a document, with conversions between positions, spans and offsets.

    Line breaks are those of YAML and of the protocol: ``\\n``, ``\\r\\n`` and ``\\r``.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.starts = [0]
        for line in _LINE.finditer(text):
            if line[0].endswith(("\r", "\n")):
                self.starts.append(line.end())

    def line(self, index: int) -> str:
        """Returns the line with the index from 0, without its line break."""
        if not 0 <= index < len(self.starts):
            return ""
        end = self.starts[index + 1] if index + 1 < len(self.starts) else len(self.text)
        return self.text[self.starts[index] : end].rstrip("\r\n")

    def offset(self, position: Position) -> int:
        """Returns the offset of the character at a position; positions outside are moved inside."""
        if position.line >= len(self.starts):
            return len(self.text)
        line, column = self.line(position.line), position.character
        if not line.isascii():
            units, count = 0, 0
            for character in line:
                if units >= column:
                    break
                units += 2 if ord(character) > 0xFFFF else 1
                count += 1
            column = count
        return self.starts[position.line] + min(column, len(line))

    def position(self, offset: int) -> Position:
        """Returns the position of the character at an offset."""
        offset = max(0, min(offset, len(self.text)))
        index = bisect.bisect_right(self.starts, offset) - 1
        return Position(index, _units(self.text[self.starts[index] : offset]))

    def offset_of(self, line: int, column: int) -> int:
        """Returns the offset of a line and column of a source span, which start at 1."""
        if line > len(self.starts):
            return len(self.text)
        return self.starts[line - 1] + min(column - 1, len(self.line(line - 1)))

    def range(self, span: Span) -> Range:
        """Returns the range of a source span."""
        return Range(
            self.position(self.offset_of(span.line, span.column)),
            self.position(self.offset_of(span.end_line, span.end_column)),
        )

    def span_text(self, span: Span) -> str:
        """Returns the text in a source span."""
        start = self.offset_of(span.line, span.column)
        return self.text[start : self.offset_of(span.end_line, span.end_column)]


def _units(text: str) -> int:
    """Returns the number of UTF-16 code units of a text."""
    return len(text) if text.isascii() else len(text) + len([c for c in text if ord(c) > 0xFFFF])
