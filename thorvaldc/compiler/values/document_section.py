"""Converts a checked document to values in SI units, as the JSON Schema of the document says.

The JSON Schema states the kind of quantity of each key (``x-quantity``), its bounds (``x-minimum``,
``x-exclusive-minimum``, ``x-maximum``: numbers in SI units or quantities such as ``60 deg``), the
diagnostic of a value out of bounds (``x-code``), and its ``default``.  Readers of documents state
none of them again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.units import QUANTITIES, parse_quantity
from thorvaldc.compiler.values.value_reader import INVALID, ValueReader, entries
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Pose
from thorvaldc.schema.documents import Kind, inlined

Schema = dict[str, Any]
_EMPTY: dict[str, Any] = {"array": (), "object": {}, "string": ""}


class Section:
    """A mapping of a document, with its values in SI units.

    The value of a key that the document does not state, or whose value is invalid, is the default
    of the schema.  A key that the schema requires has no default; if its value is invalid, an
    example of the schema takes its place, so that the other checks can continue.  What is neither
    stated nor has a default is an empty section, list or text, or else ``None``.

    ``node``: the mapping in the document, for source spans.
    """

    def __init__(self, node: Node, schema: Schema, reader: ValueReader) -> None:
        """Converts all values of the mapping and reports the values out of bounds."""
        self.node = node
        self._schema = schema
        self._reader = reader
        self._values: dict[str, Any] = {}
        properties, others = schema.get("properties", {}), schema.get("additionalProperties")
        for key, entry in entries(node).items():
            inner = properties.get(key, others)
            if isinstance(inner, dict):  # The schema check has reported unknown keys.
                value = _convert(entry, inner, reader, key)
                if value is not INVALID:
                    self._values[key] = value

    def __getitem__(self, key: str) -> Any:
        if key in self._values:
            return self._values[key]
        schema = self._schema["properties"][key]
        kind = schema.get("type")
        if "default" in schema:
            content = schema["default"]
        elif key in self._schema.get("required", ()) and kind != "object":
            content = schema.get("examples", [None])[0]
        else:
            content = _EMPTY.get(str(kind))
        if content is None:
            return None
        return _convert(_as_node(content, self.node.where), schema, self._reader, key)

    def __contains__(self, key: str) -> bool:
        """Returns whether the document states a valid value of the key."""
        return key in self._values

    def get(self, key: str, otherwise: Any) -> Any:
        """Returns the value that the document states, or ``otherwise``."""
        return self._values.get(key, otherwise)

    def items(self) -> Iterator[tuple[str, Any]]:
        """Yields the keys that the document states with their values, in the document's order."""
        yield from self._values.items()

    def entry(self, key: str) -> Node:
        """Returns the node of a key, or the node of this section if the key is not stated."""
        return self.node.get(key) or self.node

    def is_within(self, key: str, bounds: Schema) -> bool:
        """Checks a quantity against bounds that another value of the document gives.

        ``bounds``: values in SI units by the keyword of a schema, such as ``x-minimum``.
        """
        schema, span = self._schema["properties"][key], self.entry(key).span
        return _is_within(self[key], bounds, schema, span, key, self._reader.report)

    def shown(self, key: str, value: float) -> str:
        """Returns a value that the key can have as text with its SI unit."""
        return QUANTITIES[self._schema["properties"][key]["x-quantity"]].format_value(value)

    def planar_pose(self) -> Pose:
        """Returns the pose of the keys `xyz` (m) and `yaw` (rad, reduced to -pi to pi)."""
        yaw = math.remainder(self["yaw"], 2 * math.pi)
        return Pose.from_xyz_rpy(self["xyz"], (0.0, 0.0, yaw)).clean()


def read_document(document: Node, kind: Kind, reader: ValueReader) -> Section:
    """Returns the content of a document that the schema check has checked."""
    return Section(document, inlined(kind), reader)


def read_section(document: Node, kind: Kind, key: str, reader: ValueReader) -> Section:
    """Returns the content of one key of a checked document, such as `driver`."""
    node = document.get(key) or Node({}, document.span)
    return Section(node, inlined(kind)["properties"][key], reader)


def _convert(node: Node, schema: Schema, reader: ValueReader, key: str) -> Any:
    """Returns the value of a node in SI units, or ``INVALID`` if it has an error."""
    value = node.value
    if isinstance(value, dict):
        return Section(node, schema, reader)
    if isinstance(value, tuple):
        inner = schema.get("items", {})
        values = (_convert(element, inner, reader, key) for element in value)
        if "x-quantity" in inner:  # A vector keeps its length.
            return tuple(0.0 if value is INVALID else value for value in values)
        return tuple(value for value in values if value is not INVALID)
    if value is None:
        return INVALID  # The schema check has already reported the invalid value.
    quantity = schema.get("x-quantity")
    if schema.get("x-verbatim"):
        return value
    if quantity is None or value in schema.get("x-words", ()):
        return reader.value(node)
    number = reader.quantity(node, quantity, math.nan)
    if math.isnan(number) or not _is_within(number, schema, schema, node.span, key, reader.report):
        return INVALID
    return number


def _as_node(content: Any, span: Span) -> Node:
    """Returns a default or an example of a schema as if the document stated it."""
    if isinstance(content, dict):
        content = {key: _as_node(entry, span) for key, entry in content.items()}
    elif isinstance(content, list | tuple):
        content = tuple(_as_node(element, span) for element in content)
    return Node(content, span)


def _is_within(
    value: float, bounds: Schema, schema: Schema, span: Span, key: str, report: Report
) -> bool:
    """Checks that a quantity in SI units is within its bounds, and reports it if it is not."""
    quantity = schema["x-quantity"]

    def in_si(keyword: str, otherwise: float) -> float:
        bound = bounds.get(keyword, otherwise)
        return parse_quantity(bound, quantity) if isinstance(bound, str) else bound

    least, lower = in_si("x-minimum", -math.inf), in_si("x-exclusive-minimum", -math.inf)
    most = in_si("x-maximum", math.inf)
    if least <= value <= most and value > lower:
        return True
    kind = QUANTITIES[quantity]
    words = {"x-minimum": "at least", "x-exclusive-minimum": "more than", "x-maximum": "at most"}
    parts = [
        f"{word} {bound if isinstance(bound, str) else kind.format_value(bound)}"
        for keyword, word in words.items()
        if (bound := bounds.get(keyword)) is not None
    ]
    needed = " and ".join(parts)
    if len(parts) == 1 and max(least, lower) == 0.0:
        needed = "positive" if lower == 0.0 else "at least 0"
    report.add(
        schema.get("x-code", "out-of-range"),
        f"`{key}` is {kind.format_value(value)}; it must be {needed}",
        span,
    )
    return False
