"""The part of a JSON Schema that describes a place in a document, for hover and completion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.schema.documents import Kind, inlined
from thorvaldc.tools.language_server.open_document import KeyPath

Schema = dict[str, Any]


def schemas_at(kind: Kind, path: KeyPath) -> list[Schema]:
    """Returns the schemas of the value at a path, the most specific ones first."""
    schemas = [inlined(kind)]
    for key in path:
        schemas = [inner for schema in schemas for inner in _inner(schema, key)]
    return [branch for schema in schemas for branch in _branches(schema)]


def _branches(schema: Schema) -> Iterator[Schema]:
    """Yields a schema and the alternatives of which it consists."""
    yield schema
    for keyword in ("anyOf", "oneOf", "allOf"):
        for inner in schema.get(keyword, ()):
            if isinstance(inner, dict):
                yield from _branches(inner)
    for keyword in ("then", "else"):
        if isinstance(schema.get(keyword), dict):
            yield from _branches(schema[keyword])


def _inner(schema: Schema, key: str | int) -> Iterator[Schema]:
    for branch in _branches(schema):
        if isinstance(key, int):
            if isinstance(branch.get("items"), dict):
                yield branch["items"]
            continue
        properties = branch.get("properties", {})
        if key in properties:
            yield properties[key]
        elif isinstance(branch.get("additionalProperties"), dict):
            yield branch["additionalProperties"]


def keys_of(schemas: list[Schema]) -> dict[str, Schema]:
    """Returns the keys that a mapping can have, with their schemas."""
    keys: dict[str, Schema] = {}
    for schema in schemas:
        for key, inner in schema.get("properties", {}).items():
            if isinstance(inner, dict):
                keys.setdefault(key, inner)
    return keys


def required_keys(schemas: list[Schema]) -> list[str]:
    """Returns the keys that a mapping must have."""
    return [key for schema in schemas for key in schema.get("required", ())]


def values_of(schemas: list[Schema]) -> list[Any]:
    """Returns the values that a schema lists: enumerations, constants and words."""
    values: list[Any] = []
    for schema in schemas:
        listed = [*schema.get("enum", ()), *schema.get("x-words", ())]
        if "const" in schema:
            listed.append(schema["const"])
        if schema.get("type") == "boolean" or "boolean" in _types(schema):
            listed += [True, False]
        if schema.get("pattern") == "^auto$":
            listed.append("auto")
        values += [value for value in listed if value not in values]
    return values


def quantities_of(schemas: list[Schema]) -> list[str]:
    """Returns the kinds of quantity that a value can have."""
    names: list[str] = []
    for schema in schemas:
        quantity = schema.get("x-quantity", [])
        listed = [quantity] if isinstance(quantity, str) else quantity
        names += [name for name in listed if name in QUANTITIES and name not in names]
    return names


def examples_of(schemas: list[Schema]) -> list[Any]:
    """Returns the examples of a schema."""
    return [example for schema in schemas for example in schema.get("examples", ())]


def description_of(schemas: list[Schema]) -> str:
    """Returns the first description, or an empty text."""
    return next((str(s["description"]) for s in schemas if s.get("description")), "")


def takes_mapping(schema: Schema) -> bool:
    """Returns whether a value can only be a mapping."""
    return _types(schema) == ["object"]


def takes_list(schema: Schema) -> bool:
    """Returns whether a value can only be a list."""
    return _types(schema) == ["array"]


def _types(schema: Schema) -> list[str]:
    types = schema.get("type", [])
    return [types] if isinstance(types, str) else list(types)
