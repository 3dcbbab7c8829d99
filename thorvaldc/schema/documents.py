"""The schema files: for people as one document each, for the validator without references."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any, Literal

Kind = Literal["robot", "module", "fleet", "calibration", "scenario", "bus_faults"]
KINDS: tuple[Kind, ...] = ("robot", "module", "fleet", "calibration", "scenario", "bus_faults")

_COMMON = "common.schema.json#/$defs/"


@functools.cache
def _load(name: str) -> dict[str, Any]:
    text = Path(__file__).with_name(f"{name}.schema.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def bundle(kind: str) -> dict[str, Any]:
    """The schema of a kind of document, with the shared definitions that it uses inside."""
    definitions: dict[str, Any] = {}

    def local(value: Any) -> Any:
        if isinstance(value, list):
            return [local(item) for item in value]
        if not isinstance(value, dict):
            return value
        reference = value.get("$ref")
        if not isinstance(reference, str) or not reference.startswith(_COMMON):
            return {key: local(item) for key, item in value.items()}
        name = reference.removeprefix(_COMMON)
        if name not in definitions:
            definitions[name] = {}  # stands for itself while its own references are followed
            definitions[name] = local(_load("common")["$defs"][name])
        return {**{k: local(v) for k, v in value.items()}, "$ref": f"#/$defs/{name}"}

    schema: dict[str, Any] = local(_load(kind))
    return {**schema, "$defs": definitions}


def schema_text(kind: str) -> str:
    """The schema of a kind of document as JSON text that stands alone."""
    return json.dumps(bundle(kind), indent=2, ensure_ascii=False) + "\n"


@functools.cache
def inlined(kind: str) -> dict[str, Any]:
    """The schema with its references replaced by what they refer to, which validates faster.

    Parameters of modules in parameters are left open below the second level.
    """
    common = _load("common")["$defs"]

    def expand(value: Any, inside: tuple[str, ...]) -> Any:
        if isinstance(value, list):
            return [expand(item, inside) for item in value]
        if not isinstance(value, dict):
            return value
        reference = value.get("$ref")
        if not isinstance(reference, str):
            return {key: expand(item, inside) for key, item in value.items()}
        name = reference.removeprefix(_COMMON)
        if inside.count(name) > 1:
            return {}
        siblings = {key: item for key, item in value.items() if key != "$ref"}
        return {**expand(common[name], (*inside, name)), **siblings}

    schema: dict[str, Any] = expand(_load(kind), ())
    return schema
