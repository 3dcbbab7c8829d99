"""A document with its text, and changes of the text by source spans."""

from __future__ import annotations

import bisect
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.values.unit_file import with_design
from thorvaldc.diagnostics import Fix, Report, Span
from thorvaldc.schema import Kind

_LINE_BREAK = re.compile(r"\r\n|\r|\n")
BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True)
class Document:
    """A document of the language.

    - ``path``: path of the file, as the user wrote it; its text is the name in spans.
    - ``kind``: kind of the document.
    - ``data``: bytes of the document, in UTF-8.
    - ``root``: YAML tree of ``data``.
    """

    path: Path
    kind: Kind
    data: bytes
    root: Node

    @property
    def is_unit(self) -> bool:
        """Whether it is the file of a unit, which names that of its design."""
        return self.kind == "robot" and self.root.get("extends") is not None

    @cached_property
    def whole(self) -> Node:
        """The YAML tree, of a unit with the entries of its design."""
        whole = with_design(self.root, {}, self.path, Report()) if self.is_unit else None
        return whole or self.root

    @cached_property
    def text(self) -> str:
        """The text with its line breaks, without a byte order mark."""
        return self.data.decode("utf-8-sig")

    @cached_property
    def _line_starts(self) -> list[int]:
        return [0, *(match.end() for match in _LINE_BREAK.finditer(self.text))]

    def _range(self, span: Span) -> tuple[int, int]:
        starts = self._line_starts
        return (
            starts[span.line - 1] + span.column - 1,
            starts[span.end_line - 1] + span.end_column - 1,
        )

    def changed(self, changes: Iterable[Fix]) -> Document | None:
        """Returns the document with changes that do not overlap.

        Of changes that overlap, the first is made.  Returns ``None`` if no change is left, or if
        the new text is no YAML document.
        """
        ranges: list[tuple[int, int, str]] = []
        for change in changes:
            start, end = self._range(change.span)
            place = bisect.bisect(ranges, (start, end, change.text))
            before, after = ranges[place - 1 : place], ranges[place : place + 1]
            is_free = all(e <= start for _, e, _ in before) and all(end <= s for s, *_ in after)
            if is_free and self.text[start:end] != change.text:
                ranges.insert(place, (start, end, change.text))
        text = self.text
        for start, end, new in reversed(ranges):
            text = text[:start] + new + text[end:]
        mark = BYTE_ORDER_MARK if self.data.startswith(BYTE_ORDER_MARK) else b""
        report, data = Report(), mark + text.encode()
        root = read_text(data, str(self.path), report) if ranges else None
        if root is None or report.has_errors:
            return None
        return Document(self.path, self.kind, data, root)
