"""YAML values with their lines and columns in a YAML file (source spans)."""

from __future__ import annotations

from typing import Any, NamedTuple

from thorvaldc.diagnostics import Span

Value = None | bool | int | float | str | tuple["Node", ...] | dict[str, "Node"]


class Node(NamedTuple):
    """A YAML value with its source span (file, line and column).

    - ``value``: a scalar, a tuple of nodes for a list, or a dict of nodes for a mapping.
    - ``span``: source span of the value.
    - ``key_span``: source span of the key, if the value is an entry of a mapping.
    - ``quoted``: whether the value is in quotes.  In YAML, ``"3"`` is a text and ``3`` is a number.
    """

    value: Value
    span: Span
    key_span: Span | None = None
    quoted: bool = False

    def get(self, key: str) -> Node | None:
        """Returns the value of the key ``key`` in a YAML mapping.

        Returns ``None`` if the YAML mapping has no such key, or if the YAML value is not a mapping.
        """
        return self.value.get(key) if isinstance(self.value, dict) else None

    def plain(self) -> Any:
        """Returns a YAML value as plain Python dicts, lists and scalars, without source spans."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, tuple):
            return [node.plain() for node in self.value]
        return self.value

    @property
    def where(self) -> Span:
        """Source span of the YAML key, or of the YAML value if the value has no key."""
        return self.key_span or self.span


def describe_node(node: Node) -> str:
    """Describes the value of a YAML node for an error message."""
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    if node.value is None:
        return "nothing"
    if isinstance(node.value, bool):
        return f"`{str(node.value).lower()}`"
    text = str(node.value)
    return f"`{text if len(text) <= 60 else text[:57] + '...'}`"
