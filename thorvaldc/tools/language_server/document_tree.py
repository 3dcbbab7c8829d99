"""The YAML tree of a document that may be half typed, and the node at a position."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report, Span
from thorvaldc.tools.language_server.cursor import Cursor, Path
from thorvaldc.tools.language_server.source_text import SourceText

MAX_REPAIRS = 12
"""Greatest number of lines that are left out to make a document readable."""
MAX_REPAIRED = 200_000
"""Greatest length of a text that is repaired, in characters."""


def tree_of(source: SourceText, file: str) -> Node | None:
    """Returns the YAML tree of a document without the lines that have YAML errors.

    Returns ``None`` if the document is not readable.
    """
    text = source.text
    repaired: set[int] = set()
    for _ in range(MAX_REPAIRS):
        report = Report()
        node = read_text(text.encode("utf-8", "surrogatepass"), file, report)
        if node is not None or len(text) > MAX_REPAIRED:
            return node
        span = next((d.span for d in report.errors if d.span is not None), None)
        if span is None:
            return None
        index = min(span.line, len(source.starts)) - 1
        while index >= 0 and (index in repaired or not source.line(index).strip()):
            index -= 1
        if index < 0:
            return None
        repaired.add(index)
        text = _without_lines(source, repaired)
    return None


def _without_lines(source: SourceText, indices: set[int]) -> str:
    """Returns a text with empty lines in place of some lines; the other spans do not change."""
    bounds = [*source.starts, len(source.text)]
    lines = [source.text[start:end] for start, end in itertools.pairwise(bounds)]
    for index in indices:
        line = lines[index]
        lines[index] = line[len(line.rstrip("\r\n")) :]
    return "".join(lines)


def tree_around(source: SourceText, cursor: Cursor, offset: int, file: str) -> Node | None:
    """Returns the YAML tree of a document in which a user types.

    If the document is not valid YAML, the brackets around the cursor are closed at the end of the
    cursor's line.
    """
    node = read_text(source.text.encode("utf-8", "surrogatepass"), file, Report())
    if node is not None or len(source.text) > MAX_REPAIRED:
        return node
    end = source.offset_of(source.position(offset).line + 1, 1 << 30)
    word = "x" if cursor.slot != "key" and not cursor.prefix else ""
    closed = source.text[:offset] + word + cursor.quote + cursor.closing + source.text[end:]
    node = read_text(closed.encode("utf-8", "surrogatepass"), file, Report())
    return node if node is not None else tree_of(source, file)


@dataclass(frozen=True)
class Place:
    """The node at a position of a document.

    Attributes
    ----------
    path : path of the node.
    node : the node.
    part : whether the position is on the key or on the value.
    """

    path: Path
    node: Node
    part: Literal["key", "value"]

    @property
    def span(self) -> Span:
        """Span of the key or value at the position."""
        return self.node.where if self.part == "key" else self.node.span


def place_at(root: Node, line: int, column: int) -> Place | None:
    """Returns the innermost node at a line and column, which start at 1.

    Returns ``None`` if the position is in no key and in no scalar.
    """
    path: list[str | int] = []
    node = root
    while True:
        children: list[tuple[str | int, Node]] = []
        if isinstance(node.value, dict):
            children = list(node.value.items())
        elif isinstance(node.value, tuple):
            children = list(enumerate(node.value))
        elif path:
            return Place(tuple(path), node, "value")
        for key, child in children:
            if child.key_span is not None and _contains(child.key_span, line, column):
                return Place((*path, key), child, "key")
            if _contains(child.span, line, column):
                path.append(key)
                node = child
                break
        else:
            return None


def node_at(root: Node | None, path: Path) -> Node | None:
    """Returns the node at a path, or ``None``."""
    node = root
    for key in path:
        if node is None:
            return None
        if isinstance(key, int):
            items = node.value
            node = items[key] if isinstance(items, tuple) and key < len(items) else None
        else:
            node = node.get(key)
    return node


def _contains(span: Span, line: int, column: int) -> bool:
    start, end = (span.line, span.column), (span.end_line, span.end_column)
    return start <= (line, column) <= end
