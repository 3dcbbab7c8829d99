"""The tree of YAML values with their source spans."""

from __future__ import annotations

from typing import Any, NamedTuple

from thorvaldc.diagnostics import Span

Value = None | bool | int | float | str | tuple["Node", ...] | dict[str, "Node"]


class Node(NamedTuple):
    """A YAML value with its span; ``key_span`` is the span of its key in a mapping.

    ``quoted`` distinguishes ``"3"`` (text) from ``3`` (a number).
    """

    value: Value
    span: Span
    key_span: Span | None = None
    quoted: bool = False

    def get(self, key: str) -> Node | None:
        """Returns the entry of a mapping; ``None`` if it is missing, or this is no mapping."""
        return self.value.get(key) if isinstance(self.value, dict) else None

    def plain(self) -> Any:
        """Returns the value as dicts, lists and scalars without spans."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, tuple):
            return [node.plain() for node in self.value]
        return self.value

    @property
    def where(self) -> Span:
        """Span of the key if there is one, else of the value."""
        return self.key_span or self.span
