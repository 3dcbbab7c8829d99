"""Tests of the text, JSON, GitHub and SARIF forms of a report, and of the pages of codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.diagnostics import CODES, Label, Proposal, Report, Span
from thorvaldc.diagnostics.renderers import FORMATS, render, render_text
from thorvaldc.diagnostics.report import UnknownCode, explain, find_code


def text(source: str | None, *spans: Span, **options: Any) -> str:
    """Renders one diagnostic: the first span is its span, the others are labels."""
    report = Report()
    labels = [Label(span, "here too") for span in spans[1:]]
    report.add("can-id-duplicate", "both are 3", spans[0], hint="change one", labels=labels)
    file = Path("source.yaml")
    if source is not None:
        file.write_bytes(source.encode())
    return render_text(report, {"f.yaml": file}, **options)


@pytest.fixture(autouse=True)
def _work_in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def at(line: int, column: int, end_line: int, end_column: int, file: str = "f.yaml") -> Span:
    return Span(file, line, column, end_line, end_column)


def test_text() -> None:
    shown = text("a: 1\nb: {can: 3}\nc: {can: 3}\n", at(3, 10, 3, 11), at(2, 10, 2, 11))
    assert shown == (
        "f.yaml:3:10: error[TV501] can-id-duplicate: both are 3\n"
        "  |\n"
        "2 | b: {can: 3}\n"
        "  |          - here too\n"
        "3 | c: {can: 3}\n"
        "  |          ^\n"
        "  = hint: change one\n"
    )


@pytest.mark.parametrize("source", ["\na: 1", "\na: 1\n"])
def test_a_line_after_an_empty_one(source: str) -> None:
    assert "2 | a: 1\n  |    ^\n" in text(source, at(2, 4, 2, 5))


def test_an_empty_file_has_no_excerpt() -> None:
    assert text("", at(1, 1, 1, 1)).splitlines()[1:] == ["  = hint: change one"]


def test_labels_on_one_line_share_it_and_lines_between_are_omitted() -> None:
    source = "a: {b: 1, c: 2}\n" + "\n" * 9 + "d: 3\n"
    shown = text(source, at(1, 5, 1, 6), at(1, 11, 1, 12), at(11, 1, 11, 2))
    assert shown.splitlines()[1:-1] == [
        "   |",
        " 1 | a: {b: 1, c: 2}",
        "   |     ^",
        "   |           - here too",
        "...",
        "11 | d: 3",
        "   | - here too",
    ]


def test_one_omitted_line_is_shown_as_omitted() -> None:
    shown = text("a: 1\nb: 2\nc: 3\n", at(1, 4, 1, 5), at(3, 4, 3, 5))
    assert "..." in shown.splitlines()
    beside = text("a: 1\nb: 2\n", at(1, 4, 1, 5), at(2, 4, 2, 5))
    assert "..." not in beside


def test_a_label_in_another_file_names_it() -> None:
    shown = text("a: 1\n", at(1, 1, 1, 2), at(7, 3, 7, 4, "other.yaml"))
    assert "  --> other.yaml:7:3: here too\n" in shown


def test_without_the_source_there_is_no_excerpt() -> None:
    assert text(None, at(3, 10, 3, 11)).splitlines() == [
        "f.yaml:3:10: error[TV501] can-id-duplicate: both are 3",
        "  = hint: change one",
    ]


@pytest.mark.parametrize(
    ("line", "span", "excerpt", "marker"),
    [
        ("\ta:\tx", (5, 6), "    a:  x", "        ^"),
        ("日本: x", (1, 3), "日本: x", "^^^^"),
        ("日本: x", (5, 6), "日本: x", "      ^"),
        ("e\u0301: x", (4, 5), "e\u0301: x", "  ^"),
        ("a\x1b[31m: x", (8, 9), "a\ufffd[31m: x", "       ^"),
        ("a\u202eb: x", (5, 6), "a\ufffdb: x", "    ^"),
        ("a: x", (5, 5), "a: x", "    ^"),
        ("a: x", (99, 120), "a: x", "    ^"),
        ("a: 😀 b", (6, 7), "a: 😀 b", "      ^"),
    ],
)
def test_carets_are_under_the_marked_characters(
    line: str, span: tuple[int, int], excerpt: str, marker: str
) -> None:
    shown = text(line + "\nb: 1\n", at(1, span[0], 1, span[1])).splitlines()
    assert shown[2] == f"1 | {excerpt}"
    # The column of a marker is the sum of the widths of the characters before it.
    assert shown[3] == f"  | {marker}"


def test_a_span_of_several_lines_is_marked_on_its_first_line() -> None:
    shown = text("a:\n  b: 1  \n  c: 2\n", at(2, 3, 3, 7)).splitlines()
    assert shown[2:4] == ["2 |   b: 1", "  |   ^^^^"]


@pytest.mark.parametrize("column", [1, 50, 200, 396])
def test_long_lines_are_cut_around_the_span(column: int) -> None:
    line = "".join(chr(ord("a") + i % 26) for i in range(400))
    shown = text(line + "\n\n", at(1, column, 1, column + 4), width=60).splitlines()
    assert len(shown[2]) <= 60
    begin = shown[3].index("^")
    assert shown[3][begin:] == "^^^^"
    assert shown[2][begin : begin + 4] == line[column - 1 : column + 3]


def test_colours_only_if_requested() -> None:
    plain = text("a: 1\n", at(1, 1, 1, 2))
    colored = text("a: 1\n", at(1, 1, 1, 2), color=True)
    assert "\x1b" not in plain
    assert "\x1b[1;31merror[TV501]\x1b[0m" in colored
    stripped = colored
    for style in ("\x1b[1;31m", "\x1b[1;34m", "\x1b[1m", "\x1b[0m"):
        stripped = stripped.replace(style, "")
    assert stripped == plain


def test_text_of_a_document_cannot_control_the_terminal() -> None:
    report = Report()
    report.add("unknown-key", "no key `\x1b[2Ja\nb`", at(1, 1, 1, 2, "a\x07b"), hint="\x9b1m")
    for format in FORMATS:
        assert not {"\x1b", "\x07", "\x9b"} & set(render(report, format).replace("\n", ""))


def sample_report() -> Report:
    report = Report()
    report.add("can-id-duplicate", "50 %: both, 3", at(3, 10, 3, 11), hint="change one")
    report.add(
        "default-unused",
        "nothing",
        at(1, 1, 2, 5, "sub dir/ü,1:2.yaml"),
        labels=[Label(at(9, 1, 9, 3), "here")],
    )
    report.add("yaml-empty", "line\nbreak")
    return report


def test_text_shows_at_most_50_diagnostics_and_counts_the_rest() -> None:
    """Warnings are left out before errors; the other forms have all."""
    report = Report()
    for line in range(1, 61):
        report.add("angle-in-radians", f"warning {line}", at(line, 1, line, 2))
    for line in range(61, 101):
        report.add("can-id-duplicate", f"error {line}", at(line, 1, line, 2))
    lines = render_text(report, {}).splitlines()
    assert len([line for line in lines if "error[" in line]) == 40
    assert len([line for line in lines if "warning[" in line]) == 10
    assert lines[-1] == (
        "not shown: 50 more warnings or notes; `thorvaldc check --format json` lists all"
    )
    assert len(json.loads(render(report, "json"))["diagnostics"]) == 100


def test_json() -> None:
    document = json.loads(render(sample_report(), "json", builds=[{"file": "x"}]))
    assert (document["errors"], document["warnings"], document["builds"]) == (2, 1, [{"file": "x"}])
    assert document["diagnostics"][0] == {
        "code": "TV501",
        "name": "can-id-duplicate",
        "severity": "error",
        "message": "50 %: both, 3",
        "hint": "change one",
        "span": {"file": "f.yaml", "line": 3, "column": 10, "end_line": 3, "end_column": 11},
        "labels": [],
        "fixes": [],
    }
    assert document["diagnostics"][2]["span"] is None
    assert "builds" not in json.loads(render(sample_report(), "json"))


def test_github() -> None:
    assert render(sample_report(), "github").splitlines() == [
        "::error file=f.yaml,line=3,endLine=3,col=10,endColumn=11,"
        "title=TV501 can-id-duplicate::50 %25: both, 3%0Ahint: change one",
        "::warning file=sub dir/ü%2C1%3A2.yaml,line=1,endLine=2,"
        "title=TV315 default-unused::nothing%0Af.yaml:9:1: here",
        "::error title=TV104 yaml-empty::line\\nbreak",
    ]


def test_sarif() -> None:
    document = json.loads(render(sample_report(), "sarif"))
    assert document["version"] == "2.1.0"
    (run,) = document["runs"]
    rules = run["tool"]["driver"]["rules"]
    assert [rule["id"] for rule in rules] == ["TV104", "TV315", "TV501"]
    for rule in rules:
        assert rule["help"]["text"].startswith(f"# {rule['id']} ")
        assert rule["defaultConfiguration"]["level"] in ("error", "warning", "note")
    for result in run["results"]:
        assert rules[result["ruleIndex"]]["id"] == result["ruleId"]
        assert result["message"]["text"]
    first, second, third = run["results"]
    location = first["locations"][0]["physicalLocation"]
    assert location["artifactLocation"]["uri"] == "f.yaml"
    assert location["region"] == {
        "startLine": 3,
        "startColumn": 10,
        "endLine": 3,
        "endColumn": 11,
    }
    location = second["locations"][0]["physicalLocation"]
    assert location["artifactLocation"]["uri"] == "sub%20dir/%C3%BC%2C1%3A2.yaml"
    (related,) = second["relatedLocations"]
    assert related["message"]["text"] == "here"
    assert related["physicalLocation"]["region"]["startLine"] == 9
    assert "locations" not in third


def test_fixes_in_json_and_sarif() -> None:
    report = Report()
    report.add("unknown-value", "no", at(3, 10, 3, 11), hint=Proposal("write `x`", "x"))
    report.add("missing-key", "no", at(4, 1, 4, 2), hint="advice only")
    fixed, advised = json.loads(render(report, "json"))["diagnostics"]
    span = {"file": "f.yaml", "line": 3, "column": 10, "end_line": 3, "end_column": 11}
    assert fixed["fixes"] == [{"text": "x", "span": span, "is_example": False}]
    assert advised["fixes"] == []
    fixed, advised = json.loads(render(report, "sarif"))["runs"][0]["results"]
    region = {"startLine": 3, "startColumn": 10, "endLine": 3, "endColumn": 11}
    ((change,),) = [fix["artifactChanges"] for fix in fixed["fixes"]]
    assert change["artifactLocation"] == {"uri": "f.yaml"}
    assert change["replacements"] == [{"deletedRegion": region, "insertedContent": {"text": "x"}}]
    assert "fixes" not in advised


@pytest.mark.parametrize("format", FORMATS)
def test_an_empty_report(format: str) -> None:
    shown = render(Report(), format)
    if format in ("json", "sarif"):
        json.loads(shown)
    else:
        assert shown == ""


@pytest.mark.parametrize("number_or_name", ["TV501", "tv501", "501", "can-id-duplicate", " TV501 "])
def test_codes_are_found_by_number_and_by_name(number_or_name: str) -> None:
    assert find_code(number_or_name) is CODES["can-id-duplicate"]
    assert explain(number_or_name).startswith("# TV501 can-id-duplicate\n")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("can-id-duplicat", "`can-id-duplicate`"),
        ("Mount_Not_Fre", "`mount-not-free`"),
        ("zzzzzzzzz", None),
    ],
)
def test_unknown_codes_get_a_hint(name: str, hint: str | None) -> None:
    with pytest.raises(UnknownCode) as caught:
        explain(name)
    assert name in str(caught.value)
    assert caught.value.hint == (f"did you mean {hint}?" if hint else None)
