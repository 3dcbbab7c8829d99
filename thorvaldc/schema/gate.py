"""A quick look that lets good documents through; the others are for jsonschema to judge.

To import jsonschema takes longer than to compile a robot, and nearly all
documents are good.  The keywords that our schemas use are known here, and no
others: at one of those the answer is no, which costs time and nothing else.
Tests hold that this and jsonschema agree.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any


class _UnknownKeyword(Exception):
    pass


def passes(schema: dict[str, Any], value: Any) -> bool:
    """``True`` only if the plain value is valid; ``schema`` has no references."""
    try:
        return _valid(schema, value)
    except _UnknownKeyword:
        return False


def matches(pattern: str, text: str) -> bool:
    """As in a JSON Schema: `$` is the end of the text, not a line feed before it."""
    if pattern.endswith("$"):
        pattern = pattern[:-1] + r"\Z"
    return re.search(pattern, text) is not None


def _valid(schema: Any, value: Any) -> bool:
    if isinstance(schema, bool):
        return schema
    for keyword, wanted in schema.items():
        if keyword not in _SILENT:
            check = _CHECKS.get(keyword)
            if check is None:
                raise _UnknownKeyword(keyword)
            if not check(wanted, value, schema):
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


def _type(wanted: Any, value: Any, _: Any) -> bool:
    names = [wanted] if isinstance(wanted, str) else wanted
    return any(_TYPES[name](value) for name in names)


def _additional(wanted: Any, value: Any, schema: Any) -> bool:
    known = schema.get("properties", {})
    return all(_valid(wanted, entry) for key, entry in value.items() if key not in known)


def _if(wanted: Any, value: Any, schema: Any) -> bool:
    branch = "then" if _valid(wanted, value) else "else"
    return _valid(schema.get(branch, True), value)


def _same(a: Any, b: Any) -> bool:
    """Equal as JSON: ``1`` is not ``true``.  Of scalars alone; schemas have no others here."""
    return isinstance(a, bool) == isinstance(b, bool) and bool(a == b)


_Check = Callable[[Any, Any, Any], bool]


def _on(kind: type | tuple[type, ...], check: _Check) -> _Check:
    """The check of a keyword that says something of values of one type."""
    return lambda w, v, s: not isinstance(v, kind) or isinstance(v, bool) or check(w, v, s)


_NUMBER = (int, float)
# Keywords that say nothing about whether a value is valid by themselves.
_SILENT = {"description", "examples", "title", "default", "$schema", "$id", "then", "else"}
_SILENT |= {"x-quantity", "x-words", "x-expression", "x-verbatim"}
_CHECKS: dict[str, _Check] = {
    "type": _type,
    "const": lambda w, v, s: _same(w, v),
    "enum": lambda w, v, s: any(_same(one, v) for one in w),
    "anyOf": lambda w, v, s: any(_valid(one, v) for one in w),
    "not": lambda w, v, s: not _valid(w, v),
    "if": _if,
    "properties": _on(dict, lambda w, v, s: all(_valid(w[k], v[k]) for k in v if k in w)),
    "additionalProperties": _on(dict, _additional),
    "propertyNames": _on(dict, lambda w, v, s: all(_valid(w, key) for key in v)),
    "required": _on(dict, lambda w, v, s: all(key in v for key in w)),
    "dependentRequired": _on(
        dict, lambda w, v, s: all(k not in v or all(d in v for d in w[k]) for k in w)
    ),
    "minProperties": _on(dict, lambda w, v, s: len(v) >= w),
    "maxProperties": _on(dict, lambda w, v, s: len(v) <= w),
    "items": _on(list, lambda w, v, s: all(_valid(w, item) for item in v)),
    "minItems": _on(list, lambda w, v, s: len(v) >= w),
    "maxItems": _on(list, lambda w, v, s: len(v) <= w),
    "pattern": _on(str, lambda w, v, s: matches(w, v)),
    "minLength": _on(str, lambda w, v, s: len(v) >= w),
    "minimum": _on(_NUMBER, lambda w, v, s: v >= w),
    "maximum": _on(_NUMBER, lambda w, v, s: v <= w),
}
