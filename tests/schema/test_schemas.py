"""Tests of the schema files, and of the examples in the documentation against them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import parse_any, parse_quantity
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import Report
from thorvaldc.schema import KINDS, Kind, bundle, inlined, schema_text

ROOT = Path(__file__).parents[2]


def subschemas(schema: Any, name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yields the schema of every property with its dotted name."""
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
def test_a_printed_schema_has_no_external_references(kind: Kind) -> None:
    text = schema_text(kind)
    assert text.endswith("}\n")
    references = set(re.findall(r'"\$ref": "([^"]*)"', text))
    assert references <= {f"#/$defs/{name}" for name in json.loads(text)["$defs"]}


@pytest.mark.parametrize("kind", KINDS)
def test_every_property_is_described(kind: Kind) -> None:
    assert [name for name, schema in properties(kind) if not schema.get("description")] == []


@pytest.mark.parametrize("kind", KINDS)
def test_every_property_has_an_example(kind: Kind) -> None:
    """A schema with `enum`, `const` or type boolean needs no example."""
    without = [
        name
        for name, schema in properties(kind)
        if not {"examples", "enum", "const"} & schema.keys() and schema.get("type") != "boolean"
    ]
    assert without == []


@pytest.mark.parametrize("kind", KINDS)
def test_every_quantity_names_its_unit_and_has_an_example(kind: Kind) -> None:
    for name, schema in properties(kind):
        quantities = schema.get("x-quantity")
        if quantities is None or quantities == "any":
            continue
        names = [quantities] if isinstance(quantities, str) else quantities
        assert schema["examples"], name
        for example in schema["examples"]:
            if isinstance(example, str) and not example.startswith("${"):
                values = [parse_any(example)] if example not in schema.get("x-words", []) else []
                assert all(value == parse_quantity(example, names[0]) for value in values)
        for quantity in names:
            unit = QUANTITIES[quantity].unit
            assert unit == "1" or unit in schema["description"], (name, unit)


@pytest.mark.parametrize("kind", KINDS)
def test_defaults_are_within_the_bounds_of_quantities(kind: Kind) -> None:
    for name, schema in properties(kind):
        bounds = {key for key in schema if key.endswith(("-minimum", "-maximum"))}
        if not bounds:
            continue
        for stated in (
            *schema.get("examples", ()),
            *(schema[k] for k in {"default"} & set(schema)),
        ):
            report = Report()
            document = {"key": stated} if not str(stated).startswith("${") else {}
            node = read_text(json.dumps(document).encode(), "schema", report)
            assert node is not None
            Section(node, {"properties": {"key": schema}}, ValueReader(report)).read()
            assert not report.has_errors, (name, stated)


@pytest.mark.parametrize("kind", KINDS)
def test_a_required_key_has_no_default(kind: Kind) -> None:
    for name, schema in [("", inlined(kind)), *properties(kind)]:
        stated = schema.get("properties", {})
        for key in schema.get("required", ()):
            assert "default" not in stated.get(key, {}), (name, key)


# Files below `compiler` that name kinds of quantities for values that no `Section` reads yet.
OWN_QUANTITIES = (
    "bus/device_frames bus/device_sections"
    " hardware/hardware_reader hardware/purchase_reader"
    " modules/module_parameters"
)


def test_readers_take_kinds_of_quantities_from_the_schema() -> None:
    folder = ROOT / "thorvaldc" / "compiler"
    call = re.compile(r"\.(quantity|numbers)\([^)]*\"[a-z_]+\"")
    naming = [path for path in folder.rglob("*.py") if call.search(path.read_text("utf-8"))]
    names = sorted(str(path.relative_to(folder).with_suffix("")) for path in naming)
    assert names == sorted(OWN_QUANTITIES.split())


def test_params_can_have_every_quantity() -> None:
    params = inlined("module")["properties"]["params"]["additionalProperties"]
    assert params["properties"]["quantity"]["enum"] == list(QUANTITIES)


@pytest.mark.parametrize("kind", KINDS)
def test_mappings_allow_only_defined_keys(kind: Kind) -> None:
    """A mapping has only the defined keys, or names of the pattern of the language."""
    free = {"args", "env", "packages"}  # names from xacro files

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
def test_examples_match_their_schemas(kind: Kind) -> None:
    root = bundle(kind)
    for name, schema in properties(kind):
        validator = Draft202012Validator({**schema, "$defs": root["$defs"]})
        for example in schema.get("examples", []):
            assert validator.is_valid(example), (name, example)


# -- the documentation -----------------------------------------------------------------


def section(heading: str) -> str:
    text = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    match = re.search(rf"^##+ {re.escape(heading)}\n.*?^```yaml\n(.*?)^```", text, re.S | re.M)
    assert match is not None, heading
    return match[1]


def assert_valid(text: str, kind: Kind) -> None:
    report = Report()
    node = read_text(text.encode(), "language.md", report)
    assert node is not None
    check(node, kind, report)
    assert [(d.code.name, str(d.span), d.message) for d in report] == []


def test_the_page_lists_every_kind_of_quantity() -> None:
    text = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    assert [name for name in QUANTITIES if f"`{name}`" not in text] == []


HEAD = "thorvaldc: 1\ndescription: x\n"


def test_the_robot_example_of_the_page_is_valid() -> None:
    assert_valid(section("robot.yaml").replace("<name>:", "fl:"), "robot")


def test_the_calibration_example_of_the_page_is_valid() -> None:
    assert_valid(section("calibration.yaml"), "calibration")


def test_the_fleet_example_of_the_page_is_valid() -> None:
    assert_valid(section("fleet.yaml"), "fleet")


def test_the_module_example_of_the_page_is_valid() -> None:
    assert_valid(section("module.yaml"), "module")


@pytest.mark.parametrize("heading", ["Hardware", "Devices on a bus", "Assemblies"])
def test_the_module_parts_of_the_page_are_valid(heading: str) -> None:
    assert_valid(HEAD + section(heading), "module")


@pytest.mark.parametrize("kind", KINDS)
def test_defaults_that_are_described_are_valid_and_equal(kind: Kind) -> None:
    """Editors propose the keyword `default`; readers see the description."""
    for name, schema in properties(kind):
        stated = re.search(
            r"; default:? `?(true|false|-?[.\d]+(?: [a-z%/]+)?)`?\.$",
            schema["description"],
        )
        if stated is not None:
            shown = json.dumps(schema.get("default"), ensure_ascii=False).strip('"')
            assert shown == stated[1], name
        if "default" in schema:
            assert (
                Draft202012Validator(bundle(kind) | {"properties": {}, "required": []})
                .evolve(schema={**schema, "$defs": bundle(kind)["$defs"]})
                .is_valid(schema["default"])
            ), name


def test_other_editors_know_units_of_a_design() -> None:
    validator = Draft202012Validator(bundle("robot"))
    part = {"fl": {"can": 3}, "gnss": None}
    unit = {"thorvaldc": 1, "extends": "design.yaml", "name": "a", "modules": part}
    assert validator.is_valid(unit | {"modules.fl.can": 4})
    assert not validator.is_valid(unit | {"drivr": {}})
    for key in ("extends", "name"):
        assert not validator.is_valid({k: value for k, value in unit.items() if k != key}), key


def test_quantities_have_a_pattern_for_other_editors() -> None:
    validator = Draft202012Validator(bundle("robot"))
    document = {"thorvaldc": 1, "name": "a", "modules": {"f": {"type": "a/b"}}}
    for rate, is_valid in (("50 Hz", True), (50, True), (".5 kHz", True), ("fast", False)):
        assert validator.is_valid(document | {"driver": {"rate": rate}}) == is_valid, rate
