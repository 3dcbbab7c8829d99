"""The references in a document: to modules, ports, motors, parameters, module types and files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Span
from thorvaldc.tools.language_server.document_tree import Place
from thorvaldc.tools.language_server.module_view import ModuleView

_DOTTED = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")
_NAME = re.compile(r"[A-Za-z_]\w*")


@dataclass(frozen=True)
class Reference:
    """A name in a document that refers to something.

    - ``kind``: ``module`` of the document; ``port`` or ``motor`` of such a module; ``type`` of a
      module; ``file``; ``name`` of a parameter or `let` value in an expression.
    - ``name``: the name, such as ``front_left``, or the path of a file.
    - ``whole``: the dotted reference up to the name, such as ``frame.front_left``.
    - ``span``: span of the name.
    """

    kind: Literal["module", "port", "motor", "type", "file", "name"]
    name: str
    whole: str
    span: Span


def reference_at(view: ModuleView, place: Place, column: int) -> Reference | None:
    """Returns the reference at a column of a value, or ``None``."""
    if place.part == "key" or not isinstance(place.node.value, str):
        return None
    references = list(references_of(view, place.path, place.node))
    for reference in references:
        if reference.span.column <= column <= reference.span.end_column:
            return reference
    return references[0] if len(references) == 1 and references[0].kind == "type" else None


def references_of(view: ModuleView, path: tuple[str | int, ...], node: Node) -> Iterator[Reference]:
    """Yields the references in a scalar at a path of the document."""
    text = node.value
    if not isinstance(text, str) or node.span.line != node.span.end_line:
        return
    if "${" in text:
        yield from _names(node, text)
    elif path[-1:] == ("type",) and view.load(text) is not None:
        yield Reference("type", text, text, node.span)
    elif kind := _dotted_kind(path):
        yield from _dotted(view, node, text, kind)
    elif view.load(text) is not None and path[:1] != ("library",):
        yield Reference("type", text, text, node.span)
    elif _is_file(view, path, text):
        yield Reference("file", text, text, node.span)


def _dotted_kind(path: tuple[str | int, ...]) -> Literal["module", "port", "motor"] | None:
    """Returns what the last name of a dotted reference at a path names."""
    inside = path[2:] if path[:1] == ("modules",) and len(path) > 2 else ()
    if inside in (("mount",), ("mount", "port")):
        return "port"
    if inside == ("mount", "parent"):
        return "module"
    if len(inside) == 2 and inside[0] == "channels":
        return "motor"
    if len(path) == 3 and path[0] == "extras" and path[2] == "parent":
        return "port"
    if len(path) == 2 and path[0] in ("ports", "motors"):
        return "port" if path[0] == "ports" else "motor"
    return "module" if path == ("can",) else None


def _dotted(
    view: ModuleView, node: Node, text: str, kind: Literal["module", "port", "motor"]
) -> Iterator[Reference]:
    if _DOTTED.fullmatch(text) is None:
        return
    names = text.split(".")
    column = node.span.column + (1 if node.quoted else 0)
    for index, name in enumerate(names):
        is_last = index == len(names) - 1
        own = kind if is_last and index > 0 else "module"
        span = Span(node.span.file, node.span.line, column, node.span.line, column + len(name))
        yield Reference(own, name, ".".join(names[: index + 1]), span)
        column += len(name) + 1


def _names(node: Node, text: str) -> Iterator[Reference]:
    """Yields the names in an expression; the second name of ``wheel.radius`` is a part."""
    start = node.span.column + (1 if node.quoted else 0)
    for match in _DOTTED.finditer(text):
        column = start + match.start()
        whole = ""
        for name in _NAME.finditer(match[0]):
            whole = f"{whole}.{name[0]}".lstrip(".")
            yield Reference(
                "name",
                name[0],
                whole,
                Span(
                    node.span.file,
                    node.span.line,
                    column + name.start(),
                    node.span.line,
                    column + name.end(),
                ),
            )


def _is_file(view: ModuleView, path: tuple[str | int, ...], text: str) -> bool:
    if path[-1:] in (("description",), ("source",), ("name",)) or len(text) > 300 or "\0" in text:
        return False
    try:
        return (view.path.parent / text).is_file()
    except (OSError, ValueError):
        return False
