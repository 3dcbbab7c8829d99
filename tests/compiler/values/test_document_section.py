"""Tests of the conversion of a checked document to values in SI units."""

from __future__ import annotations

from typing import Any

import pytest

from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import Report

LENGTH = {"type": ["number", "string"], "x-quantity": "length"}
SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "height": {**LENGTH, "x-exclusive-minimum": 0, "x-maximum": "2 m", "examples": ["40 mm"]},
        "width": {**LENGTH, "default": "150 mm"},
        "gap": LENGTH,
        "size": {"type": "array", "items": LENGTH},
        "grid": {"type": "object", "properties": {"rows": {"type": "integer", "default": 1}}},
        "parts": {"type": "object", "additionalProperties": {"properties": {"width": LENGTH}}},
        "title": {"type": "string", "x-verbatim": True},
    },
    "required": ["height"],
}


def read(text: str) -> tuple[Section, list[str]]:
    report = Report()
    node = read_text(text.encode(), "a.yaml", report)
    assert node is not None
    section = Section(node, SCHEMA, ValueReader(report)).read()
    return section, [f"{d.span}: {d.message}" for d in report]


def test_values_are_in_si_units() -> None:
    text = "{height: 5 cm, size: [1, 20 mm], parts: {a: {width: 3 mm}}, title: '${x}'}"
    section, messages = read(text)
    assert messages == []
    assert (section["height"], section["size"], section["title"]) == (0.05, (1.0, 0.02), "${x}")
    assert [(name, part["width"]) for name, part in section["parts"].items()] == [("a", 0.003)]


def test_keys_that_are_not_stated_have_the_default_of_the_schema() -> None:
    section, _ = read("{height: 1}")
    assert (section["width"], section["gap"], section["size"], section["title"]) == (
        0.15,
        None,
        (),
        "",
    )
    assert section["grid"]["rows"] == 1
    assert "grid" not in section
    assert section.get("gap", 7) == 7


@pytest.mark.parametrize(
    ("height", "message"),
    [
        ("0", "`height` is 0 m; it must be more than 0 m and at most 2 m"),
        ("3 m", "`height` is 3 m; it must be more than 0 m and at most 2 m"),
        ("3 kg", "`3 kg` is a mass; expected a length"),
    ],
)
def test_an_invalid_value_is_reported_and_an_example_takes_its_place(
    height: str, message: str
) -> None:
    section, messages = read(f"{{height: {height}}}")
    assert messages == [f"a.yaml:1:10: {message}"]
    assert section["height"] == 0.04
    assert "height" not in section
    assert section.entry("gap") == section.node


def test_a_key_that_the_schema_does_not_have_is_a_mistake_of_the_reader() -> None:
    with pytest.raises(KeyError):
        read("{}")[0]["hight"]


def test_a_share_in_percent_without_the_unit() -> None:
    share = {"type": ["number", "string"], "x-quantity": "ratio", "x-minimum": 0, "x-maximum": 1}
    for text, fixes in (("30", ("30 %",)), ("100.5", ()), ("-3", ()), ("3", ("3 %",))):
        report = Report()
        node = read_text(f"charge: {text}".encode(), "a.yaml", report)
        assert node is not None
        Section(node, {"properties": {"charge": share}}, ValueReader(report)).read()
        (error,) = report
        assert error.code.name == "out-of-range"
        assert tuple(fix.text for fix in error.fixes) == fixes
