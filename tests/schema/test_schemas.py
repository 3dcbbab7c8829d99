"""The schema files themselves, and that the documentation's examples fit them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.source.units import QUANTITIES, parse_any, parse_quantity
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.diagnostics import Report
from thorvaldc.schema import KINDS, Kind, bundle, inlined, schema_text

ROOT = Path(__file__).parents[2]


def subschemas(schema: Any, name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every property's schema with its dotted name."""
    if isinstance(schema, list):
        for item in schema:
            yield from subschemas(item, name)
    if not isinstance(schema, dict):
        return
    for key, inner in schema.get("properties", {}).items():
        yield f"{name}.{key}".lstrip("."), inner
        yield from subschemas(inner, f"{name}.{key}")
    for key, inner in schema.items():
        if key in ("additionalProperties", "items", "anyOf", "if", "then", "else"):
            yield from subschemas(inner, f"{name}.*")
        if key == "$defs":
            for definition, value in inner.items():
                yield from subschemas(value, f"{name}.{definition}")


def properties(kind: Kind) -> list[tuple[str, dict[str, Any]]]:
    return [
        (name, schema)
        for name, schema in subschemas({k: v for k, v in bundle(kind).items() if k != "then"})
        if not set(schema) <= {"additionalProperties", "type"}  # of an `if`, `then` or `else`
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_schemas_are_valid(kind: Kind) -> None:
    for schema in (bundle(kind), inlined(kind), json.loads(schema_text(kind))):
        assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
        Draft202012Validator.check_schema(schema)


@pytest.mark.parametrize("kind", KINDS)
def test_a_printed_schema_stands_alone(kind: Kind) -> None:
    text = schema_text(kind)
    assert text.endswith("}\n")
    references = set(re.findall(r'"\$ref": "([^"]*)"', text))
    assert references <= {f"#/$defs/{name}" for name in json.loads(text)["$defs"]}


@pytest.mark.parametrize("kind", KINDS)
def test_every_property_is_described(kind: Kind) -> None:
    assert [name for name, schema in properties(kind) if not schema.get("description")] == []


@pytest.mark.parametrize("kind", KINDS)
def test_every_property_has_an_example(kind: Kind) -> None:
    """Or shows all of its values."""
    without = [
        name
        for name, schema in properties(kind)
        if not {"examples", "enum", "const"} & schema.keys() and schema.get("type") != "boolean"
    ]
    assert without == []


@pytest.mark.parametrize("kind", KINDS)
def test_every_quantity_names_its_unit_and_has_an_example(kind: Kind) -> None:
    for name, schema in properties(kind):
        wanted = schema.get("x-quantity")
        if wanted is None or wanted == "any":
            continue
        names = [wanted] if isinstance(wanted, str) else wanted
        assert schema["examples"], name
        for example in schema["examples"]:
            if isinstance(example, str) and not example.startswith("${"):
                values = [parse_any(example)] if example not in schema.get("x-words", []) else []
                assert all(value == parse_quantity(example, names[0]) for value in values)
        for quantity in names:
            unit = QUANTITIES[quantity].unit
            assert unit == "1" or unit in schema["description"], (name, unit)


def test_quantities_of_params_are_those_there_are() -> None:
    params = inlined("module")["properties"]["params"]["additionalProperties"]
    assert params["properties"]["quantity"]["enum"] == list(QUANTITIES)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_let_through_unnamed(kind: Kind) -> None:
    """Mappings have only the keys that are named, or names of the language's pattern."""
    free = {"args", "packages"}  # names that xacro files choose

    def walk(schema: Any, name: str) -> Iterator[str]:
        if isinstance(schema, list):
            for item in schema:
                yield from walk(item, name)
        if not isinstance(schema, dict):
            return
        closed = schema.get("additionalProperties") is False or "propertyNames" in schema
        if "object" in str(schema.get("type")) and "required" not in (schema.get("not") or {}):
            has_entries = "properties" in schema or "additionalProperties" in schema
            if has_entries and not closed and name not in free:
                yield name
        for key, inner in schema.items():
            if key == "properties":
                for entry, value in inner.items():
                    yield from walk(value, entry)
            elif key not in ("examples", "not", "if", "then", "else"):
                yield from walk(inner, name)

    assert list(walk(bundle(kind), "")) == []


@pytest.mark.parametrize("kind", KINDS)
def test_examples_fit_their_properties(kind: Kind) -> None:
    root = bundle(kind)
    for name, schema in properties(kind):
        validator = Draft202012Validator({**schema, "$defs": root["$defs"]})
        for example in schema.get("examples", []):
            assert validator.is_valid(example), (name, example)


# -- the documentation -----------------------------------------------------------------


def section(heading: str) -> str:
    text = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    found = re.search(rf"^##+ {re.escape(heading)}\n.*?^```yaml\n(.*?)^```", text, re.S | re.M)
    assert found is not None, heading
    return found[1]


def good(text: str, kind: Kind) -> None:
    report = Report()
    node = read_text(text.encode(), "language.md", report)
    assert node is not None
    check(node, kind, report)
    assert [(d.code.name, str(d.span), d.message) for d in report] == []


def test_the_page_lists_every_kind_of_quantity() -> None:
    text = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    assert [name for name in QUANTITIES if f"`{name}`" not in text] == []


HEAD = "thorvaldc: 1\ndescription: x\n"


def test_the_robot_of_the_page_fits() -> None:
    good(section("robot.yaml").replace("<name>:", "fl:"), "robot")


def test_the_calibration_of_the_page_fits() -> None:
    good(section("calibration.yaml"), "calibration")


def test_the_fleet_of_the_page_fits() -> None:
    good(section("fleet.yaml"), "fleet")


def test_the_module_of_the_page_fits() -> None:
    good(section("module.yaml"), "module")


@pytest.mark.parametrize("heading", ["Hardware", "Devices on a bus", "Assemblies"])
def test_the_parts_of_modules_of_the_page_fit(heading: str) -> None:
    good(HEAD + section(heading), "module")
