"""Answers the requests of an editor about one document."""

from __future__ import annotations

import difflib
import os
import re
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lsprotocol import types

from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Fleet, Robot
from thorvaldc.schema.documents import Kind
from thorvaldc.tools.language_server import module_references
from thorvaldc.tools.language_server.code_completion import (
    Proposed,
    cursor_at,
    proposals_at,
    tree_around,
)
from thorvaldc.tools.language_server.hover import hover_at
from thorvaldc.tools.language_server.module_references import definition_at
from thorvaldc.tools.language_server.module_view import ModuleView
from thorvaldc.tools.language_server.open_document import (
    OpenDocument,
    SourceText,
    uri_of,
    workspace_documents,
)

# -- the outline: sections and modules --------------------------------------------------

MAX_ENTRIES = 2000

_NAMED = frozenset(["modules", "robots", "params", "links", "joints", "ports", "motors", "wheels"])


@dataclass(frozen=True)
class Entry:
    """An entry of the outline.

    - ``name``: key of the entry.
    - ``detail``: type of the module and the port on which it is mounted, or a short value.
    - ``kind``: ``module``, ``section`` or ``value``.
    - ``span``: span from the key to the end of the value.
    - ``name_span``: span of the key.
    """

    name: str
    detail: str
    kind: str
    span: Span
    name_span: Span
    children: tuple[Entry, ...]


def outline_of(tree: Node) -> list[Entry]:
    """Returns the top-level entries of a document, with the modules inside."""
    items = tree.value.items() if isinstance(tree.value, dict) else ()
    return [_entry(key, node, 0, "") for key, node in list(items)[:MAX_ENTRIES]]


def _entry(key: str, node: Node, depth: int, section: str) -> Entry:
    children: tuple[Entry, ...] = ()
    kind, detail = "section", ""
    if isinstance(node.value, dict) and depth == 0 and key in _NAMED:
        items = list(node.value.items())[:MAX_ENTRIES]
        children = tuple(_entry(name, child, 1, key) for name, child in items)
    elif not isinstance(node.value, dict | tuple):
        kind, detail = "value", str(node.value)[:80]
    if depth == 1 and section in ("modules", "robots"):
        kind, detail = "module", _module_detail(node)
    elif depth == 1:
        kind = "value"
    start, end = node.where, node.span
    span = Span(start.file, start.line, start.column, *max(start[3:5], end[3:5]))
    return Entry(key, detail, kind, span, start, children)


def _module_detail(node: Node) -> str:
    kind, mount = node.get("type") or node.get("robot"), node.get("mount")
    if mount is not None and isinstance(mount.value, dict):
        mount = mount.get("port") or mount.get("parent")
    words = [str(kind.value)] if kind is not None else []
    words += [f"on {mount.value}"] if mount is not None else []
    return " ".join(words)


# -- the formatter ----------------------------------------------------------------------
#
# It removes spaces at the end of lines and empty lines at the end of the document, and it adds a
# missing space after a comma in brackets and the missing line break at the end.  It keeps
# comments, quotes, order, indentation and aligned columns.

_LINE = re.compile(r"([^\r\n]*)(\r\n|\r|\n|\Z)")
_BLOCK_SCALAR = re.compile(r"(?:^|[:\-])[ \t]+[|>][-+0-9]*[ \t]*(?:#.*)?$|^[|>]")
_FLOW = re.compile(r"(?:^|: |- )[ \t]*(?=[{\[])")
_COMMA = re.compile(r",(?=[^\s,}\]])")
MAX_EMPTY_LINES = 2


def formatted(text: str) -> str:
    """Returns the formatted text, or the same text if it has YAML errors."""
    before = _values(text)
    if before is None:
        return text
    result = _formatted_lines(text)
    return result if _values(result) == before else text


def _values(text: str) -> object:
    report = Report()
    node = read_text(text.encode("utf-8", "surrogatepass"), "", report)
    return None if node is None or report.has_errors else (node.plain(), _quotes(node))


def _quotes(node: object) -> object:
    value = getattr(node, "value", None)
    if isinstance(value, dict):
        return [_quotes(child) for child in value.values()]
    if isinstance(value, tuple):
        return [_quotes(child) for child in value]
    return getattr(node, "quoted", False)


def _formatted_lines(text: str) -> str:
    line_break = "\r\n" if "\r\n" in text else "\n"
    lines: list[tuple[str, str]] = []
    scalar_indent: int | None = None
    empty = 0
    for match in _LINE.finditer(text):
        line, ending = match[1], match[2]
        content = line.strip(" \t")
        indent = len(line) - len(line.lstrip(" "))
        if scalar_indent is not None and content and indent <= scalar_indent:
            scalar_indent = None
        if scalar_indent is None:
            line = _formatted_line(line)
            empty = 0 if content else empty + 1
            if empty > MAX_EMPTY_LINES:
                continue
            if content and not content.startswith("#") and _BLOCK_SCALAR.search(content):
                scalar_indent = indent
        lines.append((line, ending))
    while lines and not lines[-1][0].strip():
        lines.pop()
    if not lines:
        return text
    last, ending = lines[-1]
    return "".join(line + end for line, end in lines[:-1]) + last + (ending or line_break)


def _formatted_line(line: str) -> str:
    stripped = line.rstrip(" \t")
    flow = _FLOW.search(stripped)
    if flow is None or {"#", "'", '"'} & set(stripped):
        return stripped  # a comma in a comment or in quotes has no space of its own
    return stripped[: flow.end()] + _COMMA.sub(", ", stripped[flow.end() :])


MAX_VIEWS = 16
"""Number of documents whose modules stay in memory."""

_SYMBOLS = {
    "module": types.SymbolKind.Class,
    "section": types.SymbolKind.Namespace,
    "value": types.SymbolKind.Property,
}


class RenameError(Exception):
    """A new name that a module cannot have, or a place that has no name of a module."""


@dataclass(frozen=True)
class Session:
    """What a request may read: the open documents at the time of the request.

    - ``texts``: unsaved texts by real path.
    - ``uris``: URIs of the open documents by real path.
    - ``models``: models of the documents without errors, by URI.
    - ``folders``: library folders of the open robots.
    - ``workspace``: folders of the workspace.
    - ``has_snippets``: whether the editor supports snippets.
    """

    texts: Mapping[str, bytes]
    uris: Mapping[str, str]
    models: Mapping[str, Robot | Fleet]
    folders: tuple[Path, ...]
    workspace: tuple[Path, ...]
    has_snippets: bool


class Features:
    """Answers requests.  All methods run in one thread, which is not the thread of the protocol."""

    def __init__(self) -> None:
        self._views: OrderedDict[object, ModuleView] = OrderedDict()

    def _view(self, document: OpenDocument, kind: Kind, session: Session) -> ModuleView:
        """Returns the modules of a document, from the cache if no open text has changed."""
        key = (document.uri, tuple(session.texts.items()), session.folders)
        if key not in self._views:
            tree = document.tree
            self._views[key] = ModuleView(kind, document.path, tree, session.folders)
            while len(self._views) > MAX_VIEWS:
                self._views.popitem(last=False)
        return self._views[key]

    # -- one document -------------------------------------------------------------------

    def hover(
        self, document: OpenDocument, position: types.Position, session: Session
    ) -> types.Hover | None:
        if document.kind is None:
            return None
        with unsaved_texts(session.texts):
            view = self._view(document, document.kind, session)
            line, column = _line_and_column(document.source, position)
            answer = hover_at(view, session.models.get(document.uri), line, column)
        if answer is None:
            return None
        text, span = answer
        content = types.MarkupContent(types.MarkupKind.Markdown, text)
        return types.Hover(content, document.source.range(span))

    def completion(
        self, document: OpenDocument, position: types.Position, session: Session
    ) -> types.CompletionList | None:
        if document.kind is None:
            return None
        offset = document.source.offset(position)
        cursor = cursor_at(document.text, offset)
        with unsaved_texts(session.texts):
            tree = tree_around(document.source, cursor, offset, str(document.path))
            view = ModuleView(document.kind, document.path, tree, session.folders)
            proposals = proposals_at(view, cursor, session.models)
        items = [
            self._item(document.source, cursor.start, offset, number, proposal)
            for number, proposal in enumerate(proposals)
            if session.has_snippets or not proposal.is_snippet
        ]
        return types.CompletionList(False, items)

    def _item(
        self,
        source: SourceText,
        start: int,
        offset: int,
        number: int,
        proposal: Proposed,
    ) -> types.CompletionItem:
        place = types.Range(source.position(start + proposal.start), source.position(offset))
        after = source.text[offset : offset + 1]
        text = proposal.text
        if text.endswith(":") and after == ":":
            text = text[:-1]
        markup = types.MarkupContent(types.MarkupKind.Markdown, proposal.documentation)
        typed = source.text[start + proposal.start : offset]
        return types.CompletionItem(
            proposal.label,
            kind=types.CompletionItemKind[proposal.kind],
            detail=proposal.detail or None,
            documentation=markup if proposal.documentation else None,
            sort_text=f"{number:04}",
            filter_text=proposal.label if typed.strip() else None,
            text_edit=types.TextEdit(place, text),
            insert_text_format=types.InsertTextFormat.Snippet if proposal.is_snippet else None,
        )

    def definition(
        self, document: OpenDocument, position: types.Position, session: Session
    ) -> types.Location | None:
        if document.kind is None:
            return None
        with unsaved_texts(session.texts):
            view = self._view(document, document.kind, session)
            target = definition_at(view, *_line_and_column(document.source, position))
        if target is None:
            return None
        return _location(*target, document, session)

    def symbols(self, document: OpenDocument) -> list[types.DocumentSymbol]:
        if document.kind is None:
            return []
        tree = document.tree
        listed = outline_of(tree) if tree is not None else []
        return [_symbol(entry, document.source) for entry in listed]

    def formatting(self, document: OpenDocument) -> list[types.TextEdit]:
        if document.kind is None:
            return []
        text = formatted(document.text)
        return [] if text == document.text else list(_line_edits(document.source, text))

    # -- references ---------------------------------------------------------------------

    def _uses(
        self, document: OpenDocument, position: types.Position, session: Session
    ) -> tuple[str, Span, list[module_references.Use], ModuleView] | None:
        if document.kind not in ("robot", "module"):
            return None
        with unsaved_texts(session.texts):
            view = self._view(document, document.kind, session)
            module = module_references.module_at(view, *_line_and_column(document.source, position))
            if module is None or view.tree.get("modules") is None:
                return None
            others = workspace_documents(session.workspace, session.texts, session.uris)
            uses = module_references.uses_of(view, document, module[0], others)
        return (*module, uses, view)

    def references(
        self,
        document: OpenDocument,
        position: types.Position,
        with_definition: bool,
        session: Session,
    ) -> list[types.Location]:
        answer = self._uses(document, position, session)
        uses = answer[2] if answer is not None else []
        return [
            types.Location(use.document.uri, use.document.source.range(use.span))
            for use in uses
            if with_definition or not use.is_definition
        ]

    def prepare_rename(
        self, document: OpenDocument, position: types.Position, session: Session
    ) -> types.PrepareRenamePlaceholder | None:
        if document.kind not in ("robot", "module"):
            return None
        with unsaved_texts(session.texts):
            view = self._view(document, document.kind, session)
            module = module_references.module_at(view, *_line_and_column(document.source, position))
        if module is None:
            return None
        name, span = module
        return types.PrepareRenamePlaceholder(document.source.range(span), name)

    def rename(
        self, document: OpenDocument, position: types.Position, new_name: str, session: Session
    ) -> types.WorkspaceEdit:
        """Returns the changes of all documents.  Raises ``RenameError``."""
        answer = self._uses(document, position, session)
        if answer is None:
            raise RenameError("only modules of a robot or assembly can be renamed")
        _, _, uses, view = answer
        if module_references.NAME.fullmatch(new_name) is None:
            raise RenameError(
                f"`{new_name}` is no name: small letters, digits and `_`, a letter first"
            )
        if new_name in entries(view.tree.get("modules")):
            raise RenameError(f"there is already a module `{new_name}`")
        changes: dict[str, list[types.TextEdit]] = {}
        for use in uses:
            edit = types.TextEdit(use.document.source.range(use.span), new_name)
            changes.setdefault(use.document.uri, []).append(edit)
        return types.WorkspaceEdit(changes)


def _line_and_column(source: SourceText, position: types.Position) -> tuple[int, int]:
    """Returns a line and column of source spans, which start at 1."""
    offset = source.offset(position)
    line = min(position.line, len(source.starts) - 1)
    return line + 1, offset - source.starts[line] + 1


def _location(path: Path, span: Span, document: OpenDocument, session: Session) -> types.Location:
    if path == document.path:
        return types.Location(document.uri, document.source.range(span))
    real_path = os.path.realpath(path)
    text = session.texts.get(real_path)
    if text is None:
        try:
            text = path.read_bytes() if span.line > 1 or span.column > 1 else b""
        except OSError:
            text = b""
    source = SourceText(text.decode("utf-8", "replace"))
    uri = session.uris.get(real_path, uri_of(real_path))
    return types.Location(uri, source.range(span))


def _symbol(entry: Entry, source: SourceText) -> types.DocumentSymbol:
    return types.DocumentSymbol(
        entry.name or "?",
        _SYMBOLS[entry.kind],
        source.range(entry.span),
        source.range(entry.name_span),
        detail=entry.detail or None,
        children=[_symbol(child, source) for child in entry.children] or None,
    )


def _line_edits(source: SourceText, text: str) -> Iterable[types.TextEdit]:
    """Yields an edit for each changed group of lines, so that the cursor stays in its line."""
    before, after = _lines(source), _lines(SourceText(text))
    matcher = difflib.SequenceMatcher(None, before, after, autojunk=False)
    for tag, start, end, new_start, new_end in matcher.get_opcodes():
        if tag != "equal":
            place = types.Range(_line_start(source, start), _line_start(source, end))
            yield types.TextEdit(place, "".join(after[new_start:new_end]))


def _lines(source: SourceText) -> Sequence[str]:
    bounds = [*source.starts, len(source.text)]
    return [source.text[bounds[i] : bounds[i + 1]] for i in range(len(bounds) - 1)]


def _line_start(source: SourceText, line: int) -> types.Position:
    end = len(source.text)
    return source.position(source.starts[line] if line < len(source.starts) else end)
