"""The order of a report, and its errors and warnings."""

from __future__ import annotations

from thorvaldc.diagnostics import Report, Span


def test_diagnostics_are_sorted_by_place_and_those_without_come_last() -> None:
    report = Report()
    report.add("no-wheels", "1", None)
    report.add("yaml-tag", "2", Span("f.yaml", 9, 2))
    report.add("can-id-duplicate", "3", Span("f.yaml", 9, 1))
    report.add("unstable", "4", Span("f.yaml", 3, 5))
    report.add("yaml-syntax", "5", Span("f.yaml", 3, 5))
    report.add("skid-steering", "6", Span("a.yaml", 20, 1))
    assert [d.message for d in report.sorted()] == ["6", "5", "4", "3", "2", "1"]
    assert [d.message for d in report] == ["1", "2", "3", "4", "5", "6"]
    assert [d.message for d in report.warnings] == ["6"]
    assert [d.message for d in report.errors] == ["1", "2", "3", "4", "5"]


def test_an_added_report_keeps_its_order() -> None:
    first, second = Report(), Report()
    first.add("unstable", "1", Span("f.yaml", 3, 5))
    second.add("yaml-tag", "2", Span("f.yaml", 2, 5))
    first.extend(second)
    assert [d.message for d in first] == ["1", "2"]
    assert first.has_errors
