"""Answers the requests of an editor about one document; its outline."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from lsprotocol import types

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Span
from thorvaldc.model import Fleet, Robot
from thorvaldc.tools.language_server import code_completion, module_references, open_document
from thorvaldc.tools.language_server.cursor import cursor_at
from thorvaldc.tools.language_server.hover import hover_at
from thorvaldc.tools.language_server.module_view import ModuleView


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


def _view(document: open_document.OpenDocument, session: Session) -> ModuleView | None:
    """Returns the modules of a document, ``None`` if it is not one of thorvaldc."""
    if document.kind is None:
        return None
    return ModuleView(document.kind, document.path, document.tree, session.folders)


# -- one document -------------------------------------------------------------------


def hover(
    document: open_document.OpenDocument, params: types.HoverParams, session: Session
) -> types.Hover | None:
    view = _view(document, session)
    if view is None:
        return None
    model = session.models.get(document.uri)
    answer = hover_at(view, model, *document.source.line_and_column(params.position))
    if answer is None:
        return None
    text, span = answer
    content = types.MarkupContent(types.MarkupKind.Markdown, text)
    return types.Hover(content, document.source.range(span))


def completion(
    document: open_document.OpenDocument, params: types.CompletionParams, session: Session
) -> types.CompletionList | None:
    if document.kind is None:
        return None
    offset = document.source.offset(params.position)
    cursor = cursor_at(document.text, offset)
    tree = code_completion.tree_around(document.source, cursor, offset, str(document.path))
    view = ModuleView(document.kind, document.path, tree, session.folders)
    cursor = replace(cursor, path=view.full_path(cursor.path))
    items = [
        _completion_item(document.source, cursor.start, offset, number, proposal)
        for number, proposal in enumerate(
            code_completion.proposals_at(view, cursor, session.models)
        )
        if session.has_snippets or not proposal.is_snippet
    ]
    return types.CompletionList(False, items)


def definition(
    document: open_document.OpenDocument, params: types.DefinitionParams, session: Session
) -> types.Location | None:
    view = _view(document, session)
    if view is None:
        return None
    line, column = document.source.line_and_column(params.position)
    target = module_references.definition_at(view, line, column)
    return _location(*target, document, session) if target is not None else None


def symbols(
    document: open_document.OpenDocument, params: object, session: object
) -> list[types.DocumentSymbol]:
    if document.kind is None or document.tree is None:
        return []
    return _symbols(document.tree, document.source)


# -- references ---------------------------------------------------------------------


def _module(
    document: open_document.OpenDocument, position: types.Position, session: Session
) -> tuple[ModuleView, str, Span] | None:
    """Returns the name of the module at a position of a robot or assembly, and its span."""
    view = _view(document, session)
    if view is None or document.kind not in ("robot", "module"):
        return None
    line, column = document.source.line_and_column(position)
    module = module_references.module_at(view, line, column)
    return (view, *module) if module is not None else None


@dataclass(frozen=True)
class _Uses:
    """Uses of a module, the robot documents that have it, and a design that is out of reach."""

    uses: list[module_references.Use]
    robots: module_references.Robots
    outside: Path | None


def _uses(
    document: open_document.OpenDocument, position: types.Position, session: Session
) -> _Uses | None:
    module = _module(document, position, session)
    if module is None or module[0].document.get("modules") is None:
        return None
    view, name, _ = module
    others = open_document.workspace_documents(session.workspace, session.texts, session.uris)
    known = list(others)
    robots, outside = module_references.robots_of(view, document, name, known)
    return _Uses(module_references.uses_of(robots, name, known), robots, outside)


def references(
    document: open_document.OpenDocument, params: types.ReferenceParams, session: Session
) -> list[types.Location]:
    answer = _uses(document, params.position, session)
    return [
        types.Location(use.document.uri, use.document.source.range(use.span))
        for use in (answer.uses if answer is not None else [])
        if params.context.include_declaration or not use.is_definition
    ]


def prepare_rename(
    document: open_document.OpenDocument,
    params: types.PrepareRenameParams,
    session: Session,
) -> types.PrepareRenamePlaceholder | None:
    module = _module(document, params.position, session)
    if module is None:
        return None
    _, name, span = module
    return types.PrepareRenamePlaceholder(document.source.range(span), name)


def rename(
    document: open_document.OpenDocument, params: types.RenameParams, session: Session
) -> types.WorkspaceEdit:
    """Returns the changes of all documents.  Raises ``RenameError``."""
    answer = _uses(document, params.position, session)
    if answer is None:
        raise RenameError("only modules of a robot or assembly can be renamed")
    if answer.outside is not None:
        raise RenameError(f"the design {answer.outside} is in no folder of the workspace")
    name = params.new_name
    if module_references.NAME.fullmatch(name) is None:
        raise RenameError(f"`{name}` is no name: small letters, digits and `_`, a letter first")
    for view, robot in answer.robots:
        if name in entries(view.document.get("modules")):
            raise RenameError(f"there is already a module `{name}` in {robot.path.name}")
    changes: dict[str, list[types.TextEdit]] = {}
    for use in answer.uses:
        edit = types.TextEdit(use.document.source.range(use.span), name)
        changes.setdefault(use.document.uri, []).append(edit)
    return types.WorkspaceEdit(changes)


def _completion_item(
    source: open_document.SourceText,
    start: int,
    offset: int,
    number: int,
    proposal: code_completion.Proposed,
) -> types.CompletionItem:
    place = types.Range(source.position(start + proposal.start), source.position(offset))
    text = proposal.text
    if text.endswith(":") and source.text[offset : offset + 1] == ":":
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


def _location(
    path: Path, span: Span, document: open_document.OpenDocument, session: Session
) -> types.Location:
    if path == document.path:
        return types.Location(document.uri, document.source.range(span))
    real_path = os.path.realpath(path)
    text = session.texts.get(real_path)
    if text is None:
        try:
            text = path.read_bytes() if span.line > 1 or span.column > 1 else b""
        except OSError:
            text = b""
    source = open_document.SourceText(text.decode("utf-8", "replace"))
    uri = session.uris.get(real_path, open_document.uri_of(real_path))
    return types.Location(uri, source.range(span))


# -- the outline: sections and modules --------------------------------------------------

MAX_ENTRIES = 2000

_NAMED = frozenset(["modules", "robots", "params", "links", "joints", "ports", "motors", "wheels"])


def _symbols(
    node: Node, source: open_document.SourceText, section: str = ""
) -> list[types.DocumentSymbol]:
    """Returns the entries of a document, or of one of its sections, with the modules inside."""
    symbols: list[types.DocumentSymbol] = []
    for key, child in list(entries(node).items())[:MAX_ENTRIES]:
        kind, detail = types.SymbolKind.Namespace, ""
        children: list[types.DocumentSymbol] = []
        if not section and key in _NAMED:
            children = _symbols(child, source, key)
        if not isinstance(child.value, dict | tuple):
            kind, detail = types.SymbolKind.Property, str(child.value)[:80]
        if section in ("modules", "robots"):
            kind, detail = types.SymbolKind.Class, _module_detail(child)
        elif section:
            kind = types.SymbolKind.Property
        start, end = child.where, child.span
        span = Span(start.file, start.line, start.column, *max(start[3:5], end[3:5]))
        symbols.append(
            types.DocumentSymbol(
                key or "?",
                kind,
                source.range(span),
                source.range(start),
                detail=detail or None,
                children=children or None,
            )
        )
    return symbols


def _module_detail(node: Node) -> str:
    kind, mount = node.get("type") or node.get("robot"), node.get("mount")
    if mount is not None and isinstance(mount.value, dict):
        mount = mount.get("port") or mount.get("parent")
    words = [str(kind.value)] if kind is not None else []
    words += [f"on {mount.value}"] if mount is not None else []
    return " ".join(words)
