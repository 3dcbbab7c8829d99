"""The document as a tree of values that know where they stand."""

from __future__ import annotations

from typing import Any, NamedTuple

from thorvaldc.diagnostics import Span

Value = None | bool | int | float | str | tuple["Node", ...] | dict[str, "Node"]


class Node(NamedTuple):
    """A YAML value with its span; ``key_span`` is that of its key in a mapping.

    ``quoted`` tells ``"3"`` from ``3``: a quoted scalar is always text.
    """

    value: Value
    span: Span
    key_span: Span | None = None
    quoted: bool = False

    def get(self, key: str) -> Node | None:
        """The entry of a mapping, or ``None`` (also where this is no mapping)."""
        return self.value.get(key) if isinstance(self.value, dict) else None

    def plain(self) -> Any:
        """Plain dicts, lists and scalars, without spans."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, tuple):
            return [node.plain() for node in self.value]
        return self.value

    @property
    def where(self) -> Span:
        """The key's span where there is one, else the value's."""
        return self.key_span or self.span
