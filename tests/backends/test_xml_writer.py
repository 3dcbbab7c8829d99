from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thorvaldc.backends.xml_writer import Element, XmlValueError, number, parse, to_bytes

# The characters that XML 1.0 allows.
TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_read_back_equal(value: float) -> None:
    assert float(number(value)) == value


@pytest.mark.parametrize(
    ("value", "text"), [(-0.0, "0"), (1.0, "1"), (0.1, "0.1"), (1e-9, "1e-09"), (3, "3")]
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_infinite_numbers_are_errors(value: float) -> None:
    with pytest.raises(XmlValueError):
        Element("a", x=value)


@given(TEXT, TEXT)
def test_everything_is_escaped(attribute: str, text: str) -> None:
    root = Element("a", class_=attribute)
    root.add("b").text = text
    read = ET.fromstring(to_bytes(root))
    assert read.attrib == {"class": attribute}
    assert (read[0].text or "") == text


def test_layout_keeps_the_order() -> None:
    root = Element("a", z=1.0, b=None, c=(1.0, 2.5), d=True)
    root.add("x").add("y", name="ü")
    root.add("t").text = "1 < 2"
    assert to_bytes(root).decode() == (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<a z="1" c="1 2.5" d="true">\n'
        "  <x>\n"
        '    <y name="ü"/>\n'
        "  </x>\n"
        "  <t>1 &lt; 2</t>\n"
        "</a>\n"
    )


def test_deep_trees_are_written() -> None:
    root = leaf = Element("a")
    for _ in range(5000):
        leaf = leaf.add("b")
    assert to_bytes(root).count(b"<b") == 5000


def test_parsed_elements_keep_their_prefixes() -> None:
    text = '<gazebo xmlns:x="urn:y" x:k="1"><plugin name="p"><v> a b </v></plugin></gazebo>'
    element = parse(text)
    assert element.attributes == ' xmlns:x="urn:y" x:k="1"'
    assert element.children[0].children[0].text == " a b "
    assert ET.canonicalize(to_bytes(element).decode(), strip_text=True) == ET.canonicalize(
        text, strip_text=True
    )


def test_text_that_is_not_xml_is_an_error() -> None:
    with pytest.raises(ValueError, match="well-formed"):
        parse("<a><b></a>")
