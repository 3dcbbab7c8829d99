"""Checks documents against the JSON Schemas beside this file."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.units import QUANTITIES, UnitError, parse_any, parse_quantity
from thorvaldc.compiler.validation import schema_diagnostics as faults
from thorvaldc.diagnostics import Report, Span
from thorvaldc.schema.documents import Kind, inlined
from thorvaldc.schema.gate import matches, passes

MAX_FAULTS = 1000


def check(node: Node, kind: Kind, report: Report) -> bool:
    """Whether the document has the shape of its kind.

    What is wrong goes to ``report``, all of it (but of thousands of faults the
    first), and nothing about a value that the report has an error at already.
    """
    schema = inlined(kind)
    # A scalar that the reader found fault with has only a likely meaning.
    known = {diagnostic.span for diagnostic in report.errors if diagnostic.span is not None}
    found = False
    plain = node.plain()
    for error in () if passes(schema, plain) else _validator(kind).iter_errors(plain):
        found = True
        faults.explain(error, node, kind, known, report)
        if len(report) > MAX_FAULTS:
            return False
    for span, fault in _quantity_faults(node, schema, kind):
        if len(report) > MAX_FAULTS:
            return False
        if span not in known:
            found = True
            report.add(fault.code, fault.message, span, hint=fault.hint)
    return not found


@functools.cache
def _validator(kind: Kind) -> Any:
    from jsonschema import Draft202012Validator, ValidationError
    from jsonschema.validators import extend

    # 3.0 is an integer to JSON Schema, but no id of a device.
    checker = Draft202012Validator.TYPE_CHECKER.redefine(
        "integer", lambda _, value: isinstance(value, int) and not isinstance(value, bool)
    )

    def pattern(_validator: Any, wanted: str, value: Any, _schema: Any) -> Iterator[Any]:
        if isinstance(value, str) and not matches(wanted, value):
            yield ValidationError(f"{value!r} does not match {wanted!r}")

    strict: Any = extend(  # type: ignore[no-untyped-call]
        Draft202012Validator, {"pattern": pattern}, type_checker=checker
    )
    return strict(inlined(kind))


def without_invalid_values(node: Node, report: Report) -> Node:
    """The document with nothing in place of each value that the report has an error at.

    What is left can be given to the next stages, so that their faults are found
    in the same run.  A place keeps its key and its span.
    """
    spans = {diagnostic.span for diagnostic in report.errors if diagnostic.span is not None}
    return _blanked(node, spans) if spans else node


def _blanked(node: Node, spans: set[Span]) -> Node:
    value = node.value
    if node.span in spans:
        value = None
    elif isinstance(value, dict):
        value = {key: _blanked(entry, spans) for key, entry in value.items()}
    elif isinstance(value, tuple):
        value = tuple(_blanked(item, spans) for item in value)
    return Node(value, node.span, node.key_span, node.quoted)


# -- quantities -----------------------------------------------------------------------


def _quantity_faults(
    node: Node, schema: dict[str, Any], kind: Kind
) -> Iterator[tuple[Span, UnitError]]:
    value = node.value
    if isinstance(value, str):
        wanted = schema.get("x-quantity")
        if value.startswith("${"):
            if kind != "module" and not schema.get("x-verbatim"):
                yield node.span, _no_expression(kind)
        elif wanted is not None and value not in schema.get("x-words", ()):
            fault = _fault(value, wanted)
            if fault is not None:
                yield node.span, fault
    elif isinstance(value, dict):
        properties = schema.get("properties", {})
        others = schema.get("additionalProperties")
        for key, entry in value.items():
            inner = properties.get(key, others)
            if isinstance(inner, dict):
                yield from _quantity_faults(entry, inner, kind)
    elif isinstance(value, tuple):
        inner = schema.get("items")
        if isinstance(inner, dict):
            for item in value:
                yield from _quantity_faults(item, inner, kind)


def _fault(text: str, wanted: str | list[str]) -> UnitError | None:
    """Why the text is none of the wanted quantities, or ``None``."""
    names = [wanted] if isinstance(wanted, str) else wanted
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
        found = first.message.partition(";")[0]
        return UnitError(f"{found}; {kinds} is wanted", first.hint, first.code)
    return first


def _no_expression(kind: Kind) -> UnitError:
    return UnitError(
        f"a {kind} document has no expressions",
        "write the value; expressions belong in module documents",
        "expression-not-allowed",
    )
