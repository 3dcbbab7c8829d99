"""The outline of a document: its sections and modules."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Span

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
