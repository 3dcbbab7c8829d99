"""The JSON Schema of each kind of document, such as robot or scenario.

The files beside this one define the documents.  Text editors get a JSON Schema with local
references.  The compiler checks and reads documents by a JSON Schema without references.
"""

from __future__ import annotations

import functools
import json
import re
import typing
from collections.abc import Collection
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


def keys_of(kind: Kind) -> Collection[str]:
    """Returns the keys of the mapping that a document is."""
    keys: dict[str, Any] = _load(kind)["properties"]
    return keys


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
    if kind == "robot":
        schema = _with_units(schema)
    return {**schema, "$defs": definitions}


def _with_units(robot: dict[str, Any]) -> dict[str, Any]:
    """Returns the schema of robots for editors: a unit states parts of modules, paths and null."""
    modules = robot["properties"]["modules"]
    module = modules["additionalProperties"]
    complete = {"additionalProperties": {"type": "object", "required": module.pop("required")}}
    module["type"] = ["object", "null"]
    return robot | {
        "required": [key for key in robot["required"] if key != "modules"],
        "patternProperties": {r"^\w+\.": {}},
        "if": {"required": ["extends"]},
        "else": {"required": ["modules"], "properties": {"modules": complete}},
    }


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
