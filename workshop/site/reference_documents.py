"""The pages of the documents' keys, from the JSON Schemas: one page for each kind of document."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from thorvaldc.schema import KINDS, bounds_in_words, bundle

FILES = {
    "robot": "robot.yaml",
    "module": "module.yaml",
    "fleet": "fleet.yaml",
    "calibration": "calibration.yaml",
    "scenario": "A scenario",
    "study": "A study",
    "bus_faults": "Faults of a bus",
    "device_memory": "Memory of devices",
}
NESTED = ("properties", "additionalProperties", "items", "oneOf", "anyOf", "allOf")
DEFAULT = re.compile(r"[;,] default:? ([^;]*?)\.?$")


def pages() -> dict[str, str]:
    return {f"reference/{kind}.md": page(kind) for kind in KINDS}


def page(kind: str) -> str:
    schema = bundle(kind)
    lines = [f"# Keys: {FILES[kind]}", "", schema.get("description", ""), ""]
    lines += [
        f"The table comes from the JSON Schema that `thorvaldc schema {kind}` prints. A quantity is"
        " a number in SI or text with a unit; [the language](../language.md) explains them, and"
        " what keys mean together. `<name>` stands for a name that you choose, `[]` for each"
        " entry of a list.",
        "",
    ]
    table: list[str] = []
    for path, value, required in rows(schema, schema, "", ()):
        top = "." not in path and "[" not in path
        if top and has_keys(value, schema):
            lines += [*table, "", f"## {path}", "", description(value)[0], ""]
            table = list(HEAD)
            continue
        if not table:
            table = list(HEAD)
        text, default = description(value)
        cells = (f"`{path}`", kind_of(value), text, default or ("required" if required else ""))
        cells += (example(value),)
        table.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([*lines, *table]) + "\n"


HEAD = ("| key | value | meaning | default | example |", "| --- | --- | --- | --- | --- |")


def resolved(value: Any, schema: dict[str, Any]) -> dict[str, Any]:
    """Returns a schema without its reference; its own keys win."""
    if not isinstance(value, dict):
        return {}
    reference = value.get("$ref")
    if reference is None:
        return value
    target = schema["$defs"][reference.rsplit("/", 1)[-1]]
    return {**resolved(target, schema), **value}


def has_keys(value: dict[str, Any], schema: dict[str, Any]) -> bool:
    return next(rows(value, schema, "x", ()), None) is not None


def rows(
    value: dict[str, Any], schema: dict[str, Any], path: str, seen: tuple[str, ...]
) -> Iterator[tuple[str, dict[str, Any], bool]]:
    """Yields path, schema and whether it is required, for each key below a schema."""
    reference = value.get("$ref", "")
    if reference:
        if reference in seen:
            return
        seen = (*seen, reference)
    value = resolved(value, schema)
    prefix = f"{path}." if path else ""
    for name, inner in value.get("properties", {}).items():
        yield f"{prefix}{name}", resolved(inner, schema), name in value.get("required", ())
        yield from rows(inner, schema, f"{prefix}{name}", seen)
    others = value.get("additionalProperties")
    if isinstance(others, dict) and resolved(others, schema).get("properties"):
        yield from rows(others, schema, f"{prefix}<name>", seen)
    if isinstance(value.get("items"), dict):
        yield from rows(value["items"], schema, f"{path}[]", seen)
    for combination in ("oneOf", "anyOf", "allOf"):
        for part in value.get(combination, ()):
            yield from rows(part, schema, path, seen)


def kind_of(value: dict[str, Any]) -> str:
    if "x-quantity" in value:
        text = str(value["x-quantity"]).replace("_", " ")
    elif "enum" in value:
        text = ", ".join(f"`{choice}`" for choice in value["enum"])
    elif "const" in value:
        text = f"`{json.dumps(value['const'])}`"
    else:
        kinds = value.get("type", "any")
        names = {"object": "mapping", "array": "list", "string": "text", "boolean": "true or false"}
        kinds = [kinds] if isinstance(kinds, str) else kinds
        text = " or ".join(names.get(kind, kind) for kind in kinds)
    return ", ".join([text, *bounds_in_words(value)])


def description(value: dict[str, Any]) -> tuple[str, str]:
    """Returns what a key means, and its default."""
    text = str(value.get("description", ""))
    if "default" in value:
        return DEFAULT.sub(".", text), f"`{json.dumps(value['default'])}`"
    match = DEFAULT.search(text)
    if match is None:
        return text, ""
    return text[: match.start()] + ".", match[1]


def example(value: dict[str, Any]) -> str:
    for shown in value.get("examples", ()):
        text = shown if isinstance(shown, str) else json.dumps(shown, ensure_ascii=False)
        if len(text) <= 60:
            return f"`{text}`"
    return ""
