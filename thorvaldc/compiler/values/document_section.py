"""Converts a checked document to values in SI units, as the JSON Schema of the document says.

The JSON Schema states the kind of quantity of each key (``x-quantity``), its bounds (``x-minimum``,
``x-exclusive-minimum``, ``x-maximum``: numbers in SI units or quantities such as ``60 deg``), the
diagnostic of a value out of bounds (``x-code``), and its ``default``.  Readers of documents state
none of them again.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import parse_quantity
from thorvaldc.compiler.values.value_reader import INVALID, ValueReader, entries
from thorvaldc.diagnostics import Proposal, Span
from thorvaldc.model import Pose
from thorvaldc.schema import Kind, inlined

Schema = dict[str, Any]
_ZERO = (0.0, 0.0, 0.0)
_EMPTY: dict[str, Any] = {"array": (), "object": {}, "string": ""}
_BOUNDS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "x-minimum": ("at least", operator.ge),
    "x-exclusive-minimum": ("more than", operator.gt),
    "x-maximum": ("at most", operator.le),
}
"""Words for each bound of a quantity, and whether a value is within it."""


class Section:
    """A mapping of a document, with its values in SI units.

    Each value is converted and checked once, when it is read first, so that a module document is
    read with the parameters in scope, and only as far as its conditions `when` hold.
    ``read_document`` and ``read_section`` read everything at once, so that all errors are reported.

    The value of a key that the document does not state, or whose value is invalid, is the default
    of the schema.  A key that the schema requires has no default; if its value is invalid, an
    example of the schema takes its place, so that the other checks can continue.  What is neither
    stated nor has a default is an empty section, list or text, or else ``None``.

    Parameters
    ----------
    node : the mapping in the document, for source spans.
    schema : the part of a JSON Schema that describes the mapping.
    reader : evaluates expressions and converts units.
    alternative : index of the kind of quantity where the schema allows several, such as the angle
        of a revolute and the length of a prismatic joint.
    """

    def __init__(
        self, node: Node, schema: Schema, reader: ValueReader, alternative: int = 0
    ) -> None:
        self.node = node
        self._schema = schema
        self._reader = reader
        self._alternative = alternative
        self._entries = entries(node)
        self._values: dict[str, Any] = {}

    def _stated(self, key: str) -> Any:
        """Returns the value that the document states, or ``INVALID``."""
        entry = self._entries.get(key)
        if entry is None:
            return INVALID
        if key not in self._values:
            others = self._schema.get("additionalProperties")
            schema = self._schema.get("properties", {}).get(key, others)
            is_known = isinstance(schema, dict)  # else a reported unknown key
            self._values[key] = self._convert(entry, schema, key) if is_known else INVALID
        return self._values[key]

    def read(self) -> Section:
        """Converts all values of the section and reports their errors."""
        for key in self._entries:
            _read(self._stated(key))
        return self

    def __getitem__(self, key: str) -> Any:
        stated = self._stated(key)
        if stated is not INVALID:
            return stated
        schema = self._schema["properties"][key]
        kind = schema.get("type")
        if "default" in schema:
            content = schema["default"]
        elif key in self._schema.get("required", ()) and kind != "object":
            # An expression, or an example of another kind of quantity, is no value here.
            has_one_kind = not isinstance(schema.get("x-quantity"), list)
            examples = schema.get("examples", ()) if has_one_kind else ()
            content = next((e for e in examples if "${" not in str(e)), 1)
        else:
            content = _EMPTY.get(str(kind))
        if content is None:
            return None
        return self._convert(_as_node(content, self.node.where), schema, key)

    def __contains__(self, key: str) -> bool:
        """Returns whether the document states a valid value of the key."""
        return self._stated(key) is not INVALID

    def get(self, key: str, otherwise: Any) -> Any:
        """Returns the value that the document states, or ``otherwise``."""
        stated = self._stated(key)
        return otherwise if stated is INVALID else stated

    def items(self) -> Iterator[tuple[str, Any]]:
        """Yields the keys that the document states with their values, in the document's order."""
        for key in self._entries:
            if key in self:
                yield key, self._stated(key)

    def entry(self, key: str) -> Node:
        """Returns the node of a key, or the node of this section if the key is not stated."""
        return self.node.get(key) or self.node

    def is_within(self, key: str, bounds: Schema) -> bool:
        """Checks a quantity against bounds that another value of the document gives.

        ``bounds``: values in SI units by the keyword of a schema, such as ``x-minimum``.
        """
        schema = self._schema["properties"][key]
        return self._is_within(self[key], schema, key, self.entry(key).span, bounds)

    def shown(self, key: str, value: float) -> str:
        """Returns a value that the key can have as text with its SI unit."""
        return QUANTITIES[self._schema["properties"][key]["x-quantity"]].format_value(value)

    def pose(self) -> Pose:
        """Returns the pose of the keys `xyz` (m) and `rpy` (rad)."""
        return Pose.from_xyz_rpy(self.get("xyz", _ZERO), self.get("rpy", _ZERO))

    def planar_pose(self) -> Pose:
        """Returns the pose of the keys `xyz` (m) and `yaw` (rad, reduced to -pi to pi)."""
        yaw = math.remainder(self["yaw"], 2 * math.pi)
        return Pose.from_xyz_rpy(self["xyz"], (0.0, 0.0, yaw)).clean()

    def _convert(self, node: Node, schema: Schema, key: str) -> Any:
        """Returns the value of a node in SI units, or ``INVALID`` if it has an error."""
        value = node.value
        if isinstance(value, dict):
            return Section(node, schema, self._reader, self._alternative)
        if isinstance(value, tuple):
            inner = schema.get("items", {})
            values = [self._convert(element, inner, key) for element in value]
            if "x-quantity" in inner:  # A vector keeps its length.
                return tuple(0.0 if value is INVALID else value for value in values)
            return tuple(value for value in values if value is not INVALID)
        if value is None:
            return INVALID  # The schema check has already reported the invalid value.
        quantity = self._quantity(schema)
        if quantity is None:
            return self._scalar(node, schema, key)
        if value in schema.get("x-words", ()):
            return value
        number = self._reader.quantity(node, quantity, math.nan)
        if math.isnan(number):
            return INVALID
        is_whole = "integer" in schema.get("type", ())
        if is_whole and not number.is_integer():
            message = f"`{key}` is {number:.6g}; it must be a whole number"
            self._reader.report.add("wrong-type", message, node.span)
            return INVALID
        if not self._is_within(number, schema, key, node.span):
            return INVALID
        return round(number) if is_whole else number

    def _scalar(self, node: Node, schema: Schema, key: str) -> Any:
        if schema.get("x-verbatim"):
            return node.value
        inner, kind = schema.get("items", {}), schema.get("type")
        if "x-quantity" in inner:  # An expression gives the vector.
            numbers = self._reader.numbers(node, inner["x-quantity"], schema["minItems"])
            is_valid = numbers is INVALID or all(
                self._is_within(number, inner, key, node.span) for number in numbers
            )
            return numbers if is_valid else INVALID
        if kind == "string":
            return self._reader.of_type(str, node)
        is_boolean = kind in ("boolean", ["boolean", "string"])
        return self._reader.of_type(bool, node) if is_boolean else self._reader.value(node)

    def _is_within(
        self, value: float, schema: Schema, key: str, span: Span, bounds: Schema | None = None
    ) -> bool:
        """Checks that a quantity in SI units is within its bounds, and reports it if it is not.

        ``bounds``: bounds instead of those of the schema.
        """
        bounds = {name: (bounds or schema)[name] for name in _BOUNDS if name in (bounds or schema)}
        if not bounds:
            return True
        quantity = self._quantity(schema) or "number"
        limits = {
            name: parse_quantity(bound, quantity) if isinstance(bound, str) else bound
            for name, bound in bounds.items()
        }
        if all(_BOUNDS[name][1](value, limit) for name, limit in limits.items()):
            return True
        kind = QUANTITIES[quantity]
        parts = [
            f"{_BOUNDS[name][0]} {bound if isinstance(bound, str) else kind.format_value(bound)}"
            for name, bound in bounds.items()
        ]
        needed = f"be {' and '.join(parts)}"
        if limits == {"x-exclusive-minimum": 0.0}:
            needed = "be positive"
        elif limits == {"x-minimum": 0.0}:
            needed = "not be negative"
        shown = kind.format_value(value)
        if kind.unit == "rad" and value:
            shown += f" ({math.degrees(value):.6g} deg)"
        hint = None
        # A value below 2 may have been stated in percent, such as `110 %`.
        if limits == {"x-minimum": 0.0, "x-maximum": 1.0} and 2.0 <= value <= 100.0:
            hint = Proposal(f"did you mean `{value:.6g} %`?", f"{value:.6g} %")
        self._reader.report.add(
            schema.get("x-code", "out-of-range"),
            f"`{key}` is {shown}; it must {needed}",
            span,
            hint=hint,
        )
        return False

    def _quantity(self, schema: Schema) -> str | None:
        kinds: str | list[str] | None = schema.get("x-quantity")
        if kinds is None and schema.get("type") == ["integer", "string"]:
            return "number"  # An expression gives the whole number.
        return kinds[self._alternative] if isinstance(kinds, list) else kinds


def read_pose(node: Node, reader: ValueReader) -> Pose:
    """Returns the pose of the keys `xyz` (m) and `rpy` (rad) of a mapping."""
    return Section(node, inlined("module")["properties"]["mount"], reader).pose()


def read_document(document: Node, kind: Kind, reader: ValueReader) -> Section:
    """Returns the content of a document that the schema check has checked."""
    return Section(document, inlined(kind), reader).read()


def read_section(document: Node, kind: Kind, key: str, reader: ValueReader) -> Section:
    """Returns the content of one key of a checked document, such as `driver`."""
    node = document.get(key) or Node({}, document.span)
    return Section(node, inlined(kind)["properties"][key], reader).read()


def _read(value: Any) -> None:
    if isinstance(value, Section):
        value.read()
    elif isinstance(value, tuple):
        for element in value:
            _read(element)


def _as_node(content: Any, span: Span) -> Node:
    """Returns a default or an example of a schema as if the document stated it."""
    if isinstance(content, dict):
        content = {key: _as_node(entry, span) for key, entry in content.items()}
    elif isinstance(content, list | tuple):
        content = tuple(_as_node(element, span) for element in content)
    return Node(content, span)
