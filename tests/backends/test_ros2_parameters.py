"""Parameter files, read back with the rules of rcl's parser and by PyYAML."""

from __future__ import annotations

import math
import sys
from typing import Any

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from tests.backends.rcl_parameters import RclError, read, value_of
from thorvaldc.backends.ros2_parameters import ParameterError, parameter_file

# -- the writer ----------------------------------------------------------------------

TRAPS = [
    "y", "N", "yes", "off", "nan", "inf", "INF", "NaN", "Infinity", "1e3", "1e-3", "+1e5", "09",
    "0x1p3", "+inf", "-nan", "017", "1:30", "null", "~", "", " ", "a: b", "- a", "#", "*a", "&a",
    "!x", "%", "@", "`", '"', "'", "\\", "\\n", "line\nbreak", "tab\t", "\x00", "\x7f", "\x85",
    "\u2028", "\ufeff", "æøå", "ロボット", "🚜", "{a}", "[a]", "trailing ",
]  # fmt: skip


@pytest.mark.parametrize("text", TRAPS)
def test_text_stays_text(text: str) -> None:
    text_of_file = parameter_file({"node": {"a": text, "b": [text, text]}})
    assert read(text_of_file)["/node"] == {"a": text, "b": [text, text]}
    assert yaml.safe_load(text_of_file) == {
        "node": {"ros__parameters": {"a": text, "b": [text, text]}}
    }


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_stays_text(text: str) -> None:
    assert read(parameter_file({"node": {"a": text}}))["/node"]["a"] == text


@given(st.floats(allow_nan=False, allow_infinity=False))
@example(1e-05)
@example(1e22)
@example(-0.0)
@example(5e-324)
def test_any_real_stays_that_real(value: float) -> None:
    text_of_file = parameter_file({"node": {"a": value}})
    expected = value if abs(value) >= sys.float_info.min else 0.0
    for reading in (
        read(text_of_file)["/node"]["a"],
        yaml.safe_load(text_of_file)["node"]["ros__parameters"]["a"],
    ):
        assert type(reading) is float
        assert reading == expected


@given(st.integers(-(1 << 63), (1 << 63) - 1))
def test_any_integer_stays_that_integer(value: int) -> None:
    assert read(parameter_file({"node": {"a": value}}))["/node"] == {"a": value}


@pytest.mark.parametrize("key", ["y", "n", "on", "no", "null", "9a", "a b", "a-b", "ø", "true"])
def test_keys_stay_text(key: str) -> None:
    text_of_file = parameter_file({"node": {key: {key: 1}}})
    assert read(text_of_file)["/node"] == {f"{key}.{key}": 1}
    assert yaml.safe_load(text_of_file)["node"]["ros__parameters"] == {key: {key: 1}}


def test_a_repeated_list_is_not_an_alias() -> None:
    values = [1.0, 2.0]
    assert read(parameter_file({"node": {"a": values, "b": values}}))["/node"]["b"] == values


@pytest.mark.parametrize(
    "value", [None, [], [1, 2.0], [True, 1], [[1]], {}, math.nan, math.inf, 1 << 63, [None]]
)
def test_values_that_rcl_rejects_are_errors(value: Any) -> None:
    with pytest.raises(ParameterError, match="node"):
        parameter_file({"node": {"a": value}})


@pytest.mark.parametrize("node", ["", "a b", "1a", "a-b", "/", "a//b", "a/"])
def test_bad_node_names_are_errors(node: str) -> None:
    with pytest.raises(ParameterError):
        parameter_file({node: {"a": 1}})


# -- the reader of the tests ----------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("y", True), ("off", False), ("017", 15), ("0x10", 16), ("1:30", "1:30"), ("null", "null"),
        ("1e3", 1000.0), ("09", 9.0), ("0x1p3", 8.0), ("+1e5", 1e5), ("inf", math.inf), ("5", 5),
        ("1e-310", "1e-310"), ("abc", "abc"), ("1.5", 1.5),
    ],
)  # fmt: skip
def test_reader_finds_the_type_as_rcl_does(text: str, expected: object) -> None:
    reading = value_of(text, False)
    assert reading == expected
    assert type(reading) is type(expected)


@pytest.mark.parametrize(
    "text",
    [
        "n: {ros__parameters: {a: &x [1], b: *x}}",
        "n: {ros__parameters: {a: [[1]]}}",
        "n: {ros__parameters: {a: [1, 2.0]}}",
        "n: {ros__parameters: {a: }}",
        "n-1: {ros__parameters: {a: 1}}",
        "n: {a: 1}",
        "ros__parameters: {a: 1}",
        "n: {ros__parameters: {a: []}}",
    ],
)
def test_reader_rejects_as_rcl_does(text: str) -> None:
    with pytest.raises(RclError):
        read(text)
