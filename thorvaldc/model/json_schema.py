"""The JSON Schema of ``model.json``, generated from the dataclasses and their docstrings."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import types
import typing
from typing import Any

from thorvaldc.diagnostics import Span
from thorvaldc.model.model_json import FORMAT, KINDS, SHAPES, VERSION, type_hints
from thorvaldc.model.quantities import quantity_at

_PLAIN = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    type(None): "null",
}


def model_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``model.json``, with a definition for each class of the model."""
    definitions: dict[str, Any] = {}
    roots = [_schema_of(cls, definitions) for cls in KINDS.values()]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "The model of a robot or a fleet, as `model.json` of a build",
        "description": "All values are in SI; quaternions are (w, x, y, z).",
        "type": "object",
        "properties": {
            "format": {"const": FORMAT},
            "version": {"const": VERSION, "description": "Increased when the fields change."},
            "kind": {"enum": list(KINDS)},
            "model": {"type": "object"},
        },
        "required": ["format", "version", "kind", "model"],
        "additionalProperties": False,
        "allOf": [
            {
                "if": {"properties": {"kind": {"const": kind}}},
                "then": {"properties": {"model": root}},
            }
            for kind, root in zip(KINDS, roots, strict=True)
        ],
        "$defs": dict(sorted(definitions.items())),
    }


def model_schema_text() -> str:
    """Return the JSON Schema of ``model.json`` as JSON text."""
    return json.dumps(model_schema(), indent=2, ensure_ascii=False) + "\n"


def _schema_of(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a Python type.

    The schema of a model class is stored in ``definitions``, and the function returns a ``$ref`` to
    the stored schema.
    """
    if typing.get_origin(hint) is typing.Annotated:
        return _schema_of(hint.__origin__, definitions)
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if hint is Span or dataclasses.is_dataclass(hint):
        name = hint.__name__  # type: ignore[union-attr]
        if name not in definitions:
            if hint is Span:
                definitions[name] = _span_schema()
            else:
                definitions[name] = _class_schema(typing.cast(type, hint), definitions)
        return {"$ref": f"#/$defs/{name}"}
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return {"type": "array", "items": _schema_of(arguments[0], definitions)}
        return _list_schema([_schema_of(argument, definitions) for argument in arguments])
    if typing.get_origin(hint) not in (typing.Union, types.UnionType):
        raise TypeError(f"a field of the model cannot have the type {hint}")
    members = [_schema_of(argument, definitions) for argument in arguments]
    if all(list(member) == ["type"] for member in members):
        return {"type": [member["type"] for member in members]}
    return {"anyOf": members}


def _class_schema(cls: type, definitions: dict[str, Any]) -> dict[str, Any]:
    properties = {name: _schema_of(hint, definitions) for name, hint in type_hints(cls).items()}
    for name, schema in properties.items():
        quantity = quantity_at(cls, [name])
        if quantity is not None and quantity.unit and "$ref" not in schema:
            schema["x-quantity"] = quantity.kind
    if cls in SHAPES.values():
        properties["kind"] = {"const": cls.__name__}
    return {
        "description": _description(cls),
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _span_schema() -> dict[str, Any]:
    hints = typing.get_type_hints(Span)
    return {
        "description": f"{_description(Span)}\n\nA list of {', '.join(hints)}.",
        **_list_schema([{"type": _PLAIN[hint]} for hint in hints.values()]),
    }


def _list_schema(items: list[dict[str, Any]]) -> dict[str, Any]:
    count = len(items)
    return {
        "type": "array",
        "prefixItems": items,
        "items": False,
        "minItems": count,
        "maxItems": count,
    }


def _description(cls: type) -> str:
    """Return the docstring of a model class, with each paragraph and each list item on one line."""
    text = inspect.cleandoc(cls.__doc__ or "").replace("``", "`").replace("`None`", "`null`")
    return re.sub(r"(?<!\n)\n(?!\n|- )\s*", " ", text)
