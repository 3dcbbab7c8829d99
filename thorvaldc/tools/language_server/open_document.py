"""The documents that are open in the editor or in its workspace, and their kinds."""

from __future__ import annotations

import bisect
import itertools
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote, unquote, urlsplit

from thorvaldc.compiler.source.input_file import read_bytes, unsaved_texts
from thorvaldc.compiler.source.node import KeyPath, Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.validation.document_check import kind_of
from thorvaldc.diagnostics import Report, Span
from thorvaldc.schema import Kind

if TYPE_CHECKING:
    from lsprotocol.types import Position, Range

# -- positions in a text ----------------------------------------------------------------
#
# A source span counts lines and Unicode characters from 1. The protocol counts lines from 0, and
# columns in UTF-16 code units from 0: a character above U+FFFF has two code units.

_LINE_END = re.compile(r"(?<=\n)|(?<=\r)(?!\n)")


class SourceText:
    """The text of a document, with conversions between positions, spans and offsets.

    Line breaks are those of YAML and of the protocol: ``\\n``, ``\\r\\n`` and ``\\r``.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.lines = _LINE_END.split(text)  # with their line breaks
        self.starts = [0, *itertools.accumulate(map(len, self.lines[:-1]))]

    def line(self, index: int) -> str:
        """Returns the line with the index from 0, without its line break."""
        return self.lines[index].rstrip("\r\n") if 0 <= index < len(self.lines) else ""

    def offset(self, position: Position) -> int:
        """Returns the offset of the character at a position; positions outside are moved inside."""
        if position.line >= len(self.starts):
            return len(self.text)
        units = _utf16(self.line(position.line))[: 2 * position.character]
        return self.starts[position.line] + len(units.decode("utf-16-le", "replace"))

    def position(self, offset: int) -> Position:
        """Returns the position of the character at an offset."""
        from lsprotocol.types import Position  # not in the playground

        offset = max(0, min(offset, len(self.text)))
        index = self.line_index(offset)
        return Position(index, len(_utf16(self.text[self.starts[index] : offset])) // 2)

    def line_index(self, offset: int) -> int:
        """Returns the index from 0 of the line at an offset."""
        return bisect.bisect_right(self.starts, offset) - 1

    def line_and_column(self, position: Position) -> tuple[int, int]:
        """Returns the line and column of source spans, which start at 1, at a position."""
        line = min(position.line, len(self.starts) - 1)
        return line + 1, self.offset(position) - self.starts[line] + 1

    def offset_of(self, line: int, column: int) -> int:
        """Returns the offset of a line and column of a source span, which start at 1."""
        if line > len(self.starts):
            return len(self.text)
        return self.starts[line - 1] + min(column - 1, len(self.line(line - 1)))

    def range(self, span: Span) -> Range:
        """Returns the range of a source span."""
        from lsprotocol.types import Range

        return Range(
            self.position(self.offset_of(span.line, span.column)),
            self.position(self.offset_of(span.end_line, span.end_column)),
        )

    def span_text(self, span: Span) -> str:
        """Returns the text in a source span."""
        start = self.offset_of(span.line, span.column)
        return self.text[start : self.offset_of(span.end_line, span.end_column)]


def _utf16(text: str) -> bytes:
    return text.encode("utf-16-le", "surrogatepass")


# -- the YAML tree, and the node at a position ------------------------------------------

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
    lines = list(source.lines)
    for index in indices:
        lines[index] = lines[index][len(source.line(index)) :]
    return "".join(lines)


@dataclass(frozen=True)
class Place:
    """The node at a position of a document.

    Attributes
    ----------
    path : path of the node.
    node : the node.
    part : whether the position is on the key or on the value.
    """

    path: KeyPath
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
        if path and not isinstance(node.value, dict | tuple):
            return Place(tuple(path), node, "value")
        for key, child in node.children():
            if child.key_span is not None and _contains(child.key_span, line, column):
                return Place((*path, key), child, "key")
            if _contains(child.span, line, column):
                path.append(key)
                node = child
                break
        else:
            return None


def node_at(root: Node | None, path: KeyPath) -> Node | None:
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


@dataclass(frozen=True, eq=False)
class OpenDocument:
    """A document that is open in the editor.

    Attributes
    ----------
    uri : URI of the document, as the editor wrote it.
    path : path of the document, as the editor wrote it.  A document that was never saved has a
        path in the folder of the workspace.
    real_path : path without symbolic links, which names the document in ``unsaved_texts``.
    version : number of the change, from the editor.
    text : text of the document.
    """

    uri: str
    path: Path
    real_path: str
    version: int | None
    text: str

    @cached_property
    def source(self) -> SourceText:
        """The text with conversions of positions."""
        return SourceText(self.text)

    @cached_property
    def encoded(self) -> bytes:
        """The text as UTF-8; half of a pair of UTF-16 code units becomes invalid UTF-8."""
        return self.text.encode("utf-8", "surrogatepass")

    @cached_property
    def tree(self) -> Node | None:
        """The YAML tree without the lines that have YAML errors, or ``None``."""
        return tree_of(self.source, str(self.path))

    @cached_property
    def kind(self) -> Kind | None:
        """Kind of the document, or ``None`` if the document is not one of thorvaldc."""
        return kind_of(self.text, self.path.name)


def open_document(uri: str, version: int | None, text: str, folder: Path) -> OpenDocument:
    """Returns an open document.

    - ``folder``: folder of a document that was never saved.
    """
    path = path_of(uri) or folder / (unquote(uri).rpartition("/")[2].rpartition(":")[2] or "new")
    return OpenDocument(uri, path, os.path.realpath(path), version, text)


def texts_of(documents: Mapping[str, OpenDocument]) -> dict[str, bytes]:
    """Returns the texts of the open documents by their real paths, for ``unsaved_texts``."""
    return {document.real_path: document.encoded for document in documents.values()}


def path_of(uri: str) -> Path | None:
    """Returns the path of a URI of the scheme ``file``, or ``None``."""
    try:
        parts = urlsplit(uri)
    except ValueError:
        return None
    if parts.scheme != "file":
        return None
    path = unquote(parts.path)
    if re.match(r"/[A-Za-z]:", path):  # a drive of Windows
        path = path[1:]
    return Path(path) if path and "\0" not in path else None


def uri_of(path: Path | str) -> str:
    """Returns the URI of an absolute path."""
    text = os.fspath(path).replace("\\", "/")
    return "file://" + quote(text if text.startswith("/") else f"/{text}", errors="surrogateescape")


# -- documents in the folders of the workspace ---------------------------------------------

MAX_ENTRIES = 20_000
"""Greatest number of files and folders that are searched."""
MAX_BYTES = 1_000_000

_SKIPPED = frozenset(["node_modules", "build", "install", "log", "__pycache__"])


def workspace_documents(
    folders: Iterable[Path], texts: Mapping[str, bytes], uris: Mapping[str, str]
) -> Iterator[OpenDocument]:
    """Yields the documents of thorvaldc in the folders of the workspace, and the open ones.

    - ``texts``: unsaved texts by real path.
    - ``uris``: URIs of the open documents by real path, as the editor wrote them.
    """
    paths = dict.fromkeys([*texts, *_yaml_files(folders)])
    with unsaved_texts(texts):
        for path in paths:
            data = read_bytes(Path(path), path, Report(), limit=MAX_BYTES)
            if data is None or b"thorvaldc" not in data:
                continue
            text = data.decode("utf-8", "replace")
            yield open_document(uris.get(path, uri_of(path)), None, text, Path())


def _yaml_files(folders: Iterable[Path]) -> Iterator[str]:
    count = 0
    for folder in folders:
        for root, names, files in os.walk(folder):
            names[:] = sorted(n for n in names if n not in _SKIPPED and not n.startswith("."))
            count += len(names) + len(files)
            if count > MAX_ENTRIES:
                return
            for file in sorted(files):
                if file.endswith((".yaml", ".yml")):
                    yield os.path.realpath(os.path.join(root, file))
