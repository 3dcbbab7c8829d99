"""The JSON Schema of each kind of document, such as robot or scenario, and a fast validator.

The files beside this one define the documents.  Text editors get a JSON Schema with local
references.  The validators use a JSON Schema without references: the fast validator here, which
says only whether a document is valid, and the package jsonschema.
"""

from __future__ import annotations

import functools
import json
import re
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

Kind = Literal[
    "robot",
    "module",
    "fleet",
    "calibration",
    "scenario",
    "study",
    "bus_faults",
    "device_memory",
]
KINDS: tuple[Kind, ...] = typing.get_args(Kind)

_BOUNDS = {
    "minimum": "at least",
    "x-minimum": "at least",
    "x-exclusive-minimum": "more than",
    "maximum": "at most",
    "x-maximum": "at most",
}
_QUANTITY = r"^([-+]?\s*[.\d].*"
_EXPRESSION = r".*\$\{.*"
_COMMON = "common.schema.json#/$defs/"


@functools.cache
def _load(name: str) -> dict[str, Any]:
    text = Path(__file__).with_name(f"{name}.schema.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def bundle(kind: str) -> dict[str, Any]:
    """Returns the JSON Schema of a kind of document, including all shared definitions.

    Editors that know only JSON Schema get a pattern for each quantity: a number with or without a
    unit, an expression, or one of the words that the key allows.
    """
    definitions: dict[str, Any] = {}

    def with_local_references(value: Any) -> Any:
        if isinstance(value, list):
            return [with_local_references(item) for item in value]
        if not isinstance(value, dict):
            return value
        if "x-quantity" in value and "pattern" not in value:
            words = "".join(f"|{re.escape(word)}" for word in value.get("x-words", ()))
            value = {**value, "pattern": f"{_QUANTITY}|{_EXPRESSION}{words})$"}
        reference = value.get("$ref")
        if not isinstance(reference, str) or not reference.startswith(_COMMON):
            return {key: with_local_references(item) for key, item in value.items()}
        name = reference.removeprefix(_COMMON)
        if name not in definitions:
            definitions[name] = {}  # stops the recursion if a definition refers to itself
            definitions[name] = with_local_references(_load("common")["$defs"][name])
        return {
            **{k: with_local_references(v) for k, v in value.items()},
            "$ref": f"#/$defs/{name}",
        }

    schema: dict[str, Any] = with_local_references(_load(kind))
    return {**schema, "$defs": definitions}


def bounds_in_words(schema: dict[str, Any]) -> list[str]:
    """Returns the bounds of a value, such as ``at most `60 deg```, in Markdown.

    The keywords that begin with ``x-`` are bounds of quantities: JSON Schema knows only numbers.
    """
    return [f"{words} `{schema[key]}`" for key, words in _BOUNDS.items() if key in schema]


def schema_text(kind: str) -> str:
    """Returns the JSON Schema of a kind of document as JSON text without external references."""
    return json.dumps(bundle(kind), indent=2, ensure_ascii=False) + "\n"


@functools.cache
def inlined(kind: str) -> dict[str, Any]:
    """Returns the JSON Schema of a kind of document without references.

    Each reference (``$ref``) is replaced by its definition, because validation is then faster.
    Some schema definitions are recursive: the value of a parameter can be a module, which has
    parameters.  Below the second level of a recursive definition, the returned JSON Schema allows
    any value.
    """
    common = _load("common")["$defs"]

    def expand(value: Any, open_names: tuple[str, ...]) -> Any:
        if isinstance(value, list):
            return [expand(item, open_names) for item in value]
        if not isinstance(value, dict):
            return value
        reference = value.get("$ref")
        if not isinstance(reference, str):
            return {
                key: expand(item, open_names) if isinstance(item, dict | list) else item
                for key, item in value.items()
            }
        name = reference.removeprefix(_COMMON)
        if open_names.count(name) > 1:
            return {}
        siblings = {key: item for key, item in value.items() if key != "$ref"}
        return {**expand(common[name], (*open_names, name)), **siblings}

    schema: dict[str, Any] = expand(_load(kind), ())
    return schema


# -- fast validator ----------------------------------------------------------------

# Importing the package jsonschema takes longer than compiling a robot, and nearly all documents are
# valid.  The package jsonschema is therefore loaded only to list the errors of a document that the
# fast validator rejects.  The fast validator supports only the JSON Schema keywords that the
# schemas of this package use.  If a JSON Schema contains any other keyword, the fast validator
# rejects the document, and the package jsonschema decides.  Tests check that both agree.


class _UnknownKeyword(Exception):
    pass


def passes(schema: dict[str, Any], value: Any) -> bool:
    """Returns whether a value matches a JSON Schema without unknown keywords.

    - ``schema``: a JSON Schema without references.
    - ``value``: the document as plain Python dicts, lists and scalars.
    """
    try:
        return _valid(schema, value)
    except _UnknownKeyword:
        return False


def matches(pattern: str, text: str) -> bool:
    """Returns whether a text matches a regular expression (``pattern``) of a JSON Schema.

    In a Python regular expression, `$` also matches before a line feed at the end of a text.  In a
    JSON Schema pattern, `$` matches only at the end of the text.
    """
    if pattern.endswith("$"):
        pattern = pattern[:-1] + r"\Z"
    return re.search(pattern, text) is not None


def _valid(schema: Any, value: Any) -> bool:
    if isinstance(schema, bool):
        return schema
    kind = type(value)
    for keyword, argument in schema.items():
        if keyword in _IGNORED:
            continue
        entry = _CHECKS.get(keyword)
        if entry is None:
            raise _UnknownKeyword(keyword)
        kinds, check = entry
        # A keyword such as ``minLength`` applies only to some types.
        if (kinds is None or kind in kinds) and not check(argument, value, schema):
            return False
    return True


_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
    "null": (type(None),),
}


def _type(types: Any, value: Any, _: Any) -> bool:
    if isinstance(types, str):
        return type(value) in _TYPES[types]
    return any(type(value) in _TYPES[name] for name in types)


# Loops, because a generator for each of the thousands of objects would take twice the time.


def _properties(properties: Any, value: Any, _: Any) -> bool:
    for key, entry in value.items():
        if key in properties and not _valid(properties[key], entry):
            return False
    return True


def _additional(additional: Any, value: Any, schema: Any) -> bool:
    properties = schema.get("properties", ())
    for key, entry in value.items():
        if key not in properties and not _valid(additional, entry):
            return False
    return True


def _all_valid(schema: Any, values: Any, _: Any) -> bool:
    for value in values:  # noqa: SIM110
        if not _valid(schema, value):
            return False
    return True


def _any_valid(schemas: Any, value: Any, _: Any) -> bool:
    for schema in schemas:  # noqa: SIM110
        if _valid(schema, value):
            return True
    return False


def _if(condition: Any, value: Any, schema: Any) -> bool:
    branch = "then" if _valid(condition, value) else "else"
    return _valid(schema.get(branch, True), value)


def _equal(a: Any, b: Any) -> bool:
    """Returns whether two scalars are equal in JSON, where ``1`` does not equal ``true``."""
    return isinstance(a, bool) == isinstance(b, bool) and bool(a == b)


_Check = Callable[[Any, Any, Any], bool]
"""Checks one keyword of a schema.

The first parameter is the argument of the keyword.  The second parameter is the value to check.
The third parameter is the schema that contains the keyword.
"""
_OBJECT, _ARRAY, _STRING, _NUMBER = (dict,), (list,), (str,), (int, float)
# JSON Schema keywords that have no check function: annotations, and the keywords `then` and `else`,
# which the function `_if` evaluates.
_IGNORED = {"description", "examples", "title", "default", "$schema", "$id", "then", "else"}
# Of quantities: `document_section`.
_IGNORED |= {"x-quantity", "x-words", "x-verbatim", "x-code"}
_IGNORED |= {"x-minimum", "x-exclusive-minimum", "x-maximum"}
_CHECKS: dict[str, tuple[tuple[type, ...] | None, _Check]] = {
    "type": (None, _type),
    "const": (None, lambda w, v, s: _equal(w, v)),
    "enum": (None, lambda w, v, s: any(_equal(option, v) for option in w)),
    "anyOf": (None, _any_valid),
    "not": (None, lambda w, v, s: not _valid(w, v)),
    "if": (None, _if),
    "properties": (_OBJECT, _properties),
    "additionalProperties": (_OBJECT, _additional),
    "propertyNames": (_OBJECT, _all_valid),
    "required": (_OBJECT, lambda w, v, s: all(map(v.__contains__, w))),
    "dependentRequired": (
        _OBJECT,
        lambda w, v, s: all(k not in v or all(d in v for d in w[k]) for k in w),
    ),
    "minProperties": (_OBJECT, lambda w, v, s: len(v) >= w),
    "maxProperties": (_OBJECT, lambda w, v, s: len(v) <= w),
    "items": (_ARRAY, _all_valid),
    "minItems": (_ARRAY, lambda w, v, s: len(v) >= w),
    "maxItems": (_ARRAY, lambda w, v, s: len(v) <= w),
    "pattern": (_STRING, lambda w, v, s: matches(w, v)),
    "minLength": (_STRING, lambda w, v, s: len(v) >= w),
    "minimum": (_NUMBER, lambda w, v, s: v >= w),
    "maximum": (_NUMBER, lambda w, v, s: v <= w),
}
"""The check of each keyword, and the types of values to which it applies, ``None`` for all."""
