"""Tests of the YAML reader: values, spans, errors and limits."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.compiler.source import reader
from thorvaldc.compiler.source.node import Node, yaml_text
from thorvaldc.compiler.source.reader import read_file, read_text
from thorvaldc.diagnostics import Report


def read(text: str | bytes) -> tuple[Node | None, Report]:
    report = Report()
    data = text if isinstance(text, bytes) else text.encode()
    return read_text(data, "f.yaml", report), report


def read_valid(text: str) -> Node:
    node, report = read(text)
    assert list(report) == []
    assert node is not None
    return node


def only_error(text: str | bytes) -> tuple[str, str]:
    """Returns the code and the span of the only diagnostic."""
    _, report = read(text)
    (diagnostic,) = report
    return diagnostic.code.name, str(diagnostic.span)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12", 12),
        ("-3", -3),
        ("+5", 5),
        ("0", 0),
        ("0x2A", 42),
        ("0o17", 15),
        ("1e3", 1000.0),
        ("1.5", 1.5),
        ("1.", 1.0),
        ("-.5", -0.5),
        ("007.5", 7.5),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("12:30", "12:30"),
        ("42:1", "42:1"),
        ("1_000", "1_000"),
        ("0b101", "0b101"),
        ("2026-01-01", "2026-01-01"),
        ("650 mm", "650 mm"),
        ('"12"', "12"),
        ("'on'", "on"),
        ('"010"', "010"),
        ("on top", "on top"),
        ("nope", "nope"),
    ],
)
def test_scalars_follow_yaml_1_2(text: str, value: Any) -> None:
    node = read_valid(f"a: {text}\n").get("a")
    assert node is not None
    assert node.value == value
    assert type(node.value) is type(value)


def test_quoted_numbers_are_text() -> None:
    node = read_valid("a: '3'\nb: 3\nc: |\n  3\n")
    assert [node.value[k].quoted for k in "abc"] == [True, False, True]


@pytest.mark.parametrize(
    "word", [*("on", "off", "yes", "no", "y", "n"), *("ON", "Off", "Yes", "N")]
)
def test_ambiguous_words_are_refused_as_values_only(word: str) -> None:
    assert only_error(f"a: {word}\n") == ("yaml-ambiguous-word", "f.yaml:1:4")
    assert read_valid(f"{word}: 1\n").get(word) is not None


def test_one_run_reports_all_errors_in_scalars() -> None:
    node, report = read("a: on\nb: 010\nc: .inf\nd: 1e999\ne: 99999999999999999999\nf: !!str 3\n")
    assert [(d.code.name, d.span.line) for d in report if d.span] == [
        ("yaml-ambiguous-word", 1),
        ("yaml-leading-zero", 2),
        ("yaml-not-finite", 3),
        ("yaml-number-range", 4),
        ("yaml-number-range", 5),
        ("yaml-tag", 6),
    ]
    assert node is not None
    assert node.plain()["b"] == 10  # continues with the most likely value


def test_very_long_numbers_are_errors() -> None:
    assert only_error("a: " + "9" * 5000)[0] == "yaml-number-range"
    assert only_error("a: 0" + "9" * 5000)[0] == "yaml-leading-zero"
    assert only_error("a: 0x" + "f" * 5000)[0] == "yaml-number-range"


def test_spans_count_characters() -> None:
    node = read_valid("ä: éè  # c\nb: {日本: x, '😀': 12}\n")
    inner = node.get("b")
    assert inner is not None
    first, second = inner.value["日本"], inner.value["😀"]
    assert (first.key_span, first.span) == (
        (("f.yaml", 2, 5, 2, 7)),
        (("f.yaml", 2, 9, 2, 10)),
    )
    assert second.span == ("f.yaml", 2, 17, 2, 19)
    assert node.get("ä").span == ("f.yaml", 1, 4, 1, 6)  # type: ignore[union-attr]


def test_a_block_ends_with_its_last_value() -> None:
    node = read_valid("a:\n  b: 1\n  c: [2,\n    3]\n\n# end\nd: 4\n").get("a")
    assert node is not None
    assert node.span == ("f.yaml", 2, 3, 4, 7)


def test_line_ends_and_byte_order_mark_do_not_move_spans() -> None:
    assert only_error("\ufeffa: on\n") == ("yaml-ambiguous-word", "f.yaml:1:4")
    assert only_error("a: 1\r\nb: on\r\n") == ("yaml-ambiguous-word", "f.yaml:2:4")
    assert only_error("a: 1\rb: on\r") == ("yaml-ambiguous-word", "f.yaml:2:4")


def test_aliases_share_a_value_under_their_own_keys() -> None:
    node = read_valid("a: &x {b: 1}\nc: *x\nd: [*x, *x]\n")
    assert node.plain() == {"a": {"b": 1}, "c": {"b": 1}, "d": [{"b": 1}, {"b": 1}]}
    assert node.get("c").key_span.line == 2  # type: ignore[union-attr]
    assert node.span.end_line == 3


def test_billion_laughs_document_is_an_error() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 30)]
    began = time.process_time()
    assert only_error("\n".join(lines))[0] == "yaml-too-many-values"
    assert time.process_time() - began < 2


@pytest.mark.parametrize(
    ("text", "code", "span"),
    [
        ("", "yaml-empty", "f.yaml:1:1"),
        ("# only this\n", "yaml-empty", "f.yaml:1:1"),
        ("---\n", "yaml-empty", "f.yaml:1:1"),
        ("a: 1\n---\nb: 2\n", "yaml-several-documents", "f.yaml:2:1"),
        ("a: 1\na: 2\n", "yaml-duplicate-key", "f.yaml:2:1"),
        ("a: {b: 1, c: 2, b: 3}\n", "yaml-duplicate-key", "f.yaml:1:17"),
        ("1: a\n", "yaml-key-not-text", "f.yaml:1:1"),
        ("1.5: a\n", "yaml-key-not-text", "f.yaml:1:1"),
        ("null: a\n", "yaml-key-not-text", "f.yaml:1:1"),
        ("a: {[1]: 2}\n", "yaml-key-not-text", "f.yaml:1:5"),
        ("a: &x {b: 1}\nc: {<<: *x}\n", "yaml-merge-key", "f.yaml:2:5"),
        ("a: &x [*x]\n", "yaml-recursive-alias", "f.yaml:1:4"),
        ("a: !!python/object/apply:os.system ['true']\n", "yaml-tag", "f.yaml:1:4"),
        ("a: *x\n", "yaml-syntax", "f.yaml:1:4"),
        ("a: [1, 2\nb: 3\n", "yaml-syntax", "f.yaml:1:4"),
        ("a: {b: 1,\n    c: [2}\n", "yaml-syntax", "f.yaml:2:10"),
        ('a: "x\n', "yaml-syntax", "f.yaml:1:4"),
        ("a: b: c\n", "yaml-syntax", "f.yaml:1:5"),
        ("a: @x\n", "yaml-syntax", "f.yaml:1:4"),
        ("a: 1\n b: 2\n", "yaml-syntax", "f.yaml:2:1"),
        ("a:\n\tb: 1\n", "yaml-tab", "f.yaml:2:1"),
        ("a: x\x01y\n", "yaml-character", "f.yaml:1:5"),
        ("a: x\u2028y\n", "yaml-character", "f.yaml:1:5"),
        (b"a: 1\nb: \xe4\n", "yaml-encoding", "f.yaml:2:4"),
        ("a: b".encode("utf-16"), "yaml-encoding", "f.yaml:1:1"),
    ],
)
def test_refused(text: str | bytes, code: str, span: str) -> None:
    assert only_error(text) == (code, span)


def test_the_hint_for_an_expression_in_braces_is_to_quote_it() -> None:
    _, report = read("a: {x: ${y}, z: 1}\n")
    (diagnostic,) = report
    assert diagnostic.hint is not None
    assert "quoted" in diagnostic.hint


@pytest.mark.parametrize("levels", [60, 900, 1100, 40_000])
@pytest.mark.parametrize(
    ("opener", "column"), [("[", 50), ("{a: ", 197), ("- ", 99), ("? ", 99), ("- ? ", 99)]
)
def test_the_limit_of_the_nesting_is_our_own(opener: str, column: int, levels: int) -> None:
    """libyaml 0.2.6 has one of 1000 levels, and older ones would exhaust the stack."""
    assert only_error(opener * levels) == ("yaml-too-deep", f"f.yaml:1:{column}")


def test_an_error_before_a_deep_nesting_is_reported_as_without_it() -> None:
    assert only_error("a: ] " + "[" * 2000) == only_error("a: ] ") == ("yaml-syntax", "f.yaml:1:4")


def test_more_than_a_megabyte_is_not_read() -> None:
    assert only_error("#" * (reader.MAX_BYTES + 1))[0] == "yaml-file-too-large"


@pytest.mark.parametrize(
    "text",
    ["a: b\n" * 150_000, "- &a" + "\n- *a" * 150_000, "on: on\n" * 100_000, "[a,[" * 200_000],
)
def test_large_and_odd_texts_are_refused_quickly(text: str) -> None:
    began = time.process_time()
    _, report = read(text)
    assert report.has_errors
    assert time.process_time() - began < 5


def test_the_time_to_read_joints_grows_with_their_number() -> None:
    def seconds(number: int) -> float:
        joint = "{type: revolute, parent: a, child: b, xyz: [0, 1.5, 650 mm], lower: -90 deg}"
        text = ("joints:\n" + "".join(f"  j{i}: {joint}\n" for i in range(number))).encode()
        began = time.process_time()
        assert read_text(text, "f.yaml", Report()) is not None
        return time.process_time() - began

    few, many = (min(seconds(number) for _ in range(3)) for number in (100, 1000))
    assert many < 40.0 * few  # 10 if each joint takes the same time, 100 if it grows with them


def test_files(tmp_path: Path) -> None:
    def code(path: Path) -> str:
        report = Report()
        assert read_file(path, "shown", report) is None
        (diagnostic,) = report
        assert diagnostic.span is not None
        assert diagnostic.span.file == "shown"
        return diagnostic.code.name

    assert code(tmp_path / "missing.yaml") == "file-not-found"
    assert code(tmp_path) == "file-is-a-directory"
    assert code(tmp_path / ("x" * 300)) == "file-unreadable"
    assert code(Path("a\0b")) == "file-unreadable"


@pytest.mark.parametrize(
    "text",
    ["- a", "-", "x ", "1 ", ".inf", "-.INF", "--- a", "...", "a: b", "a:", "\x85", "0x12", "yes"],
)
def test_a_text_that_yaml_reads_otherwise_gets_quotes(text: str) -> None:
    report = Report()
    document = read_text(f"key: {yaml_text(text)}\n".encode(), "", report)
    assert document is not None
    assert (document.plain(), list(report)) == ({"key": text}, [])
    assert yaml_text("0.9 m") == "0.9 m"
