"""A fast JSON Schema validator that reports only whether a document is valid.

Importing the package jsonschema takes longer than compiling a robot, and nearly all documents are
valid.  The package jsonschema is therefore loaded only to list the errors of a document that the
fast validator rejects.  The fast validator supports only the JSON Schema keywords that the schemas
of this package use.  If a JSON Schema contains any other keyword, the fast validator rejects the
document, and the package jsonschema decides.  Tests check that the fast validator and the package
jsonschema agree.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any


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
    for keyword, argument in schema.items():
        if keyword not in _IGNORED:
            check = _CHECKS.get(keyword)
            if check is None:
                raise _UnknownKeyword(keyword)
            if not check(argument, value, schema):
                return False
    return True


_TYPES: dict[str, Callable[[Any], bool]] = {
    "object": lambda v: isinstance(v, dict),
    "array": lambda v: isinstance(v, list),
    "string": lambda v: isinstance(v, str),
    "boolean": lambda v: isinstance(v, bool),
    "integer": lambda v: isinstance(v, int) and not isinstance(v, bool),
    "number": lambda v: isinstance(v, int | float) and not isinstance(v, bool),
    "null": lambda v: v is None,
}


def _type(types: Any, value: Any, _: Any) -> bool:
    names = [types] if isinstance(types, str) else types
    return any(_TYPES[name](value) for name in names)


def _additional(additional: Any, value: Any, schema: Any) -> bool:
    properties = schema.get("properties", {})
    return all(_valid(additional, entry) for key, entry in value.items() if key not in properties)


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


def _for_type(kind: type | tuple[type, ...], check: _Check) -> _Check:
    """Restricts the check of a JSON Schema keyword to values of the Python type ``kind``.

    For example, the JSON Schema keyword ``minLength`` applies only to texts.
    """
    return lambda w, v, s: not isinstance(v, kind) or isinstance(v, bool) or check(w, v, s)


_NUMBER = (int, float)
# JSON Schema keywords that have no check function: annotations, and the keywords `then` and `else`,
# which the function `_if` evaluates.
_IGNORED = {"description", "examples", "title", "default", "$schema", "$id", "then", "else"}
_IGNORED |= {"x-quantity", "x-words", "x-verbatim"}
_IGNORED |= {
    "x-minimum",
    "x-exclusive-minimum",
    "x-maximum",
    "x-code",
}  # of quantities: `document_section`
_CHECKS: dict[str, _Check] = {
    "type": _type,
    "const": lambda w, v, s: _equal(w, v),
    "enum": lambda w, v, s: any(_equal(option, v) for option in w),
    "anyOf": lambda w, v, s: any(_valid(option, v) for option in w),
    "not": lambda w, v, s: not _valid(w, v),
    "if": _if,
    "properties": _for_type(dict, lambda w, v, s: all(_valid(w[k], v[k]) for k in v if k in w)),
    "additionalProperties": _for_type(dict, _additional),
    "propertyNames": _for_type(dict, lambda w, v, s: all(_valid(w, key) for key in v)),
    "required": _for_type(dict, lambda w, v, s: all(key in v for key in w)),
    "dependentRequired": _for_type(
        dict, lambda w, v, s: all(k not in v or all(d in v for d in w[k]) for k in w)
    ),
    "minProperties": _for_type(dict, lambda w, v, s: len(v) >= w),
    "maxProperties": _for_type(dict, lambda w, v, s: len(v) <= w),
    "items": _for_type(list, lambda w, v, s: all(_valid(w, item) for item in v)),
    "minItems": _for_type(list, lambda w, v, s: len(v) >= w),
    "maxItems": _for_type(list, lambda w, v, s: len(v) <= w),
    "pattern": _for_type(str, lambda w, v, s: matches(w, v)),
    "minLength": _for_type(str, lambda w, v, s: len(v) >= w),
    "minimum": _for_type(_NUMBER, lambda w, v, s: v >= w),
    "maximum": _for_type(_NUMBER, lambda w, v, s: v <= w),
}
