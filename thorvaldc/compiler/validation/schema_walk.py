"""Walks over a document and its JSON Schema at once: the shape and the quantities of each value.

Importing the package jsonschema takes longer than compiling a robot, and nearly all documents are
valid.  The walk therefore says only whether the shape of a document is valid; jsonschema is loaded
to list the errors of one that is not.  The walk knows the keywords that the schemas of this package
use.  Tests check that both agree.

The keyword ``x-quantity`` names the allowed kinds of quantity, such as a length.  JSON Schema has
no units, so that the walk reports each text that is not such a quantity itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any, parse_quantity
from thorvaldc.diagnostics import Span
from thorvaldc.schema import Kind


class SchemaWalk:
    """The walk over one document.

    - ``kind``: kind of the document.  Only module documents have expressions.
    - ``errors``: errors of quantities and expressions, with their source spans.
    """

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.errors: list[tuple[Span, UnitError]] = []

    def fits(self, schema: Any, node: Node) -> bool:
        """Returns whether a value has the shape of a JSON Schema without references.

        Adds the errors of the quantities in the value to ``errors``.
        """
        if isinstance(schema, bool):
            return schema
        value_type, is_valid = type(node.value), True
        for keyword, argument in schema.items():
            rule = _CHECKS.get(keyword)
            if rule is None:
                continue  # one of ``_ANNOTATIONS``
            # A keyword such as ``minLength`` applies only to some types.
            types, check = rule
            if (types is None or value_type in types) and not check(self, argument, node, schema):
                is_valid = False
        if value_type is str and self.kind != "module" and node.value.startswith("${"):  # type: ignore[union-attr]
            self._expression(node, schema)
        return is_valid

    # The loops have no generators, which would take twice the time for thousands of values.

    def _properties(self, properties: Any, node: Any, _: Any) -> bool:
        is_valid = True
        for key, entry in node.value.items():
            if key in properties and not self.fits(properties[key], entry):
                is_valid = False
        return is_valid

    def _additional(self, additional: Any, node: Any, schema: Any) -> bool:
        properties, is_valid = schema.get("properties", ()), True
        for key, entry in node.value.items():
            if key not in properties and not self.fits(additional, entry):
                is_valid = False
        return is_valid

    def _items(self, schema: Any, node: Any, _: Any) -> bool:
        is_valid = True
        for element in node.value:
            if not self.fits(schema, element):
                is_valid = False
        return is_valid

    def _if(self, condition: Any, node: Node, schema: Any) -> bool:
        branch = "then" if self.fits(condition, node) else "else"
        return self.fits(schema.get(branch, True), node)

    def _quantity(self, quantities: str | list[str], node: Any, schema: Any) -> bool:
        text = node.value
        if not text.startswith("${") and text not in schema.get("x-words", ()):
            error = quantity_error(text, quantities)
            if error is not None:
                self.errors.append((node.span, error))
        return True

    def _expression(self, node: Node, schema: Any) -> None:
        if not schema.get("x-verbatim"):
            error = UnitError(
                f"a {self.kind} document cannot contain expressions",
                "write the value; expressions belong in module documents",
                "expression-not-allowed",
            )
            self.errors.append((node.span, error))


def quantity_error(text: str, quantities: str | list[str]) -> UnitError | None:
    """Returns the error of a text that is not a quantity, or ``None`` if it is one.

    - ``quantities``: one or several allowed kinds of quantity; ``any`` allows every kind.
    """
    names = [quantities] if isinstance(quantities, str) else quantities
    first: UnitError | None = None
    for quantity in names:
        try:
            if quantity == "any":
                parse_any(text)
            else:
                parse_quantity(text, quantity)
        except UnitError as error:
            first = first or error
        else:
            return None
    if first is not None and first.code == "wrong-dimension" and len(names) > 1:
        kinds = " or ".join(str(QUANTITIES[name]) for name in names)
        actual = first.message.partition(";")[0]
        return UnitError(f"{actual}; expected {kinds}", first.hint, first.code)
    return first


def matches(pattern: str, text: str) -> bool:
    """Returns whether a text matches a regular expression (``pattern``) of a JSON Schema.

    In a Python regular expression, `$` also matches before a line feed at the end of a text.  In a
    JSON Schema pattern, `$` matches only at the end of the text.
    """
    if pattern.endswith("$"):
        pattern = pattern[:-1] + r"\Z"
    return re.search(pattern, text) is not None


_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (tuple,),
    "string": (str,),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
    "null": (type(None),),
}


def _has_type(types: str | list[str], value: Any) -> bool:
    if isinstance(types, str):
        return type(value) in _TYPES[types]
    return any(type(value) in _TYPES[name] for name in types)


def _equal(a: Any, b: Any) -> bool:
    """Returns whether two scalars are equal in JSON, where ``1`` does not equal ``true``."""
    return isinstance(a, bool) == isinstance(b, bool) and bool(a == b)


_Check = Callable[[SchemaWalk, Any, Any, Any], bool]
"""Checks one keyword of a schema: its parameters are the walk, the argument of the keyword, the
node to check and the schema that contains the keyword.
"""
_OBJECT, _ARRAY, _STRING, _NUMBER = (dict,), (tuple,), (str,), (int, float)
# Keywords without a check.  ``_if`` reads `then` and `else`; ``Section`` reads the bounds of
# quantities, which also apply to the values of expressions.
_ANNOTATIONS = {"description", "examples", "title", "default", "$schema", "$id", "then", "else"}
_ANNOTATIONS |= {"x-words", "x-verbatim", "x-code", "x-minimum", "x-exclusive-minimum", "x-maximum"}
_CHECKS: dict[str, tuple[tuple[type, ...] | None, _Check]] = {
    "type": (None, lambda _, a, n, s: _has_type(a, n.value)),
    "const": (None, lambda _, a, n, s: _equal(a, n.value)),
    "enum": (None, lambda _, a, n, s: any(_equal(option, n.value) for option in a)),
    "anyOf": (None, lambda walk, a, n, s: any(walk.fits(schema, n) for schema in a)),
    "not": (None, lambda walk, a, n, s: not walk.fits(a, n)),
    "if": (None, SchemaWalk._if),
    "properties": (_OBJECT, SchemaWalk._properties),
    "additionalProperties": (_OBJECT, SchemaWalk._additional),
    "propertyNames": (
        _OBJECT,
        lambda _, a, n, s: all(matches(a["pattern"], key) for key in n.value),
    ),
    "required": (_OBJECT, lambda _, a, n, s: all(map(n.value.__contains__, a))),
    "dependentRequired": (
        _OBJECT,
        lambda _, a, n, s: all(k not in n.value or all(d in n.value for d in a[k]) for k in a),
    ),
    "minProperties": (_OBJECT, lambda _, a, n, s: len(n.value) >= a),
    "maxProperties": (_OBJECT, lambda _, a, n, s: len(n.value) <= a),
    "items": (_ARRAY, SchemaWalk._items),
    "minItems": (_ARRAY, lambda _, a, n, s: len(n.value) >= a),
    "maxItems": (_ARRAY, lambda _, a, n, s: len(n.value) <= a),
    "pattern": (_STRING, lambda _, a, n, s: matches(a, n.value)),
    "x-quantity": (_STRING, SchemaWalk._quantity),
    "minLength": (_STRING, lambda _, a, n, s: len(n.value) >= a),
    "maxLength": (_STRING, lambda _, a, n, s: len(n.value) <= a),
    "minimum": (_NUMBER, lambda _, a, n, s: n.value >= a),
    "maximum": (_NUMBER, lambda _, a, n, s: n.value <= a),
}
"""The check of each keyword, and the types of values to which it applies, ``None`` for all."""
