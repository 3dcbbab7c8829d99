"""The numbers and expressions in the documents of a robot, and documents with changed values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.diagnostics import Span

Key = str | int
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")
# Keys whose values are text for readers, or the version of the language.
_TEXT_KEYS = ("description", "source", "thorvaldc", "name", "color")


@dataclass(frozen=True)
class SourceValue:
    """A number or an expression in a document of the robot.

    Attributes
    ----------
    keys : keys and list indices from the root of the document to the value.
    node : the YAML node with the span of the value.
    sections : spans of the keys of the sections that contain the value, the innermost first.
    """

    keys: tuple[Key, ...]
    node: Node
    sections: tuple[Span, ...] = ()

    @property
    def span(self) -> Span:
        return self.node.span

    @property
    def is_expression(self) -> bool:
        return isinstance(self.node.value, str) and "${" in self.node.value

    @property
    def is_integer(self) -> bool:
        return isinstance(self.node.value, int)

    @property
    def key_path(self) -> str:
        """Text of the position, such as ``links.body.parts[0].mass``."""
        return key_path(self.keys)


def key_path(keys: Iterable[Key]) -> str:
    """Returns keys and indices as text, such as ``links.body.parts[0].mass``."""
    text = ""
    for key in keys:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else key
    return text


def source_values(
    node: Node, keys: tuple[Key, ...] = (), sections: tuple[Span, ...] = ()
) -> Iterator[SourceValue]:
    """Yields the numbers, quantities and expressions of a document."""
    if isinstance(node.value, dict | tuple):
        inner = (node.where, *sections)
        is_mapping = isinstance(node.value, dict)
        items = node.value.items() if is_mapping else enumerate(node.value)  # type: ignore[union-attr]
        for key, item in items:
            if key not in _TEXT_KEYS:
                yield from source_values(item, (*keys, key), inner)
    elif _is_numeric(node):
        yield SourceValue(keys, node, sections)


def _is_numeric(node: Node) -> bool:
    value = node.value
    if isinstance(value, bool) or value is None:
        return False
    if isinstance(value, int | float):
        return not node.quoted
    if not isinstance(value, str):
        return False
    if value.startswith("${") and value.endswith("}"):
        return True
    if not _NUMBER.match(value):
        return False
    try:
        parse_any(value)
    except UnitError:
        return False
    return True


def incremented(value: Any, step: int) -> Any:
    """Returns an integer value of a node, changed by ``step``."""
    return value + step


def scaled(value: Any, change: float) -> Any:
    """Returns the value of a node, changed by the relative amount ``change``.

    A value of 0 becomes ``change`` in its own unit.
    """
    if isinstance(value, int | float):
        return value * (1.0 + change) if value else change
    if value.startswith("${"):
        return f"${{({value[2:-1]}) * {1.0 + change!r}}}"
    match = _NUMBER.match(value)
    number = float(match[1]) if match else 0.0
    new = number * (1.0 + change) if number else change
    return f"{new!r}{value[match.end() :] if match else ''}"


def with_values(document: Node, values: Iterable[tuple[tuple[Key, ...], Any]]) -> Node:
    """Returns a copy of a document in which the values at some keys are replaced."""
    tree: dict[Any, Any] = {}
    for keys, value in values:
        branch = tree
        for key in keys[:-1]:
            branch = branch.setdefault(key, {})
        branch[keys[-1]] = _Leaf(value)
    return _rebuilt(document, tree) if tree else document


@dataclass(frozen=True)
class _Leaf:
    value: Any


def _rebuilt(node: Node, tree: Any) -> Node:
    if isinstance(tree, _Leaf):
        return node._replace(value=tree.value)
    if isinstance(node.value, dict):
        changed = {key: _rebuilt(node.value[key], branch) for key, branch in tree.items()}
        return node._replace(value={**node.value, **changed})
    items = list(node.value) if isinstance(node.value, tuple) else []
    for index, branch in tree.items():
        items[index] = _rebuilt(items[index], branch)
    return node._replace(value=tuple(items))
