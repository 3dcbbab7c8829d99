"""Reports for people and for machines: text, json, github, sarif.

``sources`` maps the names of files in spans to where they lie; a file that is
not there is shown without an excerpt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics.excerpt import Excerpts, json_text, printable
from thorvaldc.diagnostics.report import Diagnostic, Report, Severity, Span

FORMATS = ("text", "json", "github", "sarif")

_STYLES = {
    Severity.ERROR: "1;31",
    Severity.WARNING: "1;33",
    Severity.NOTE: "1;36",
}
_QUIET = "1;34"


def render(
    report: Report,
    format: str,
    sources: Mapping[str, Path] | None = None,
    *,
    builds: Sequence[Mapping[str, Any]] | None = None,
) -> str:
    """The report in one of FORMATS, without colours.

    ``builds`` are results that the JSON form carries along.
    """
    if format == "json":
        return render_json(report, builds=builds)
    if format == "github":
        return render_github(report)
    if format == "sarif":
        from thorvaldc.diagnostics.sarif import render_sarif

        return render_sarif(report)
    return render_text(report, sources or {})


# -- text -------------------------------------------------------------------------------


def render_text(
    report: Report, sources: Mapping[str, Path], *, color: bool = False, width: int = 100
) -> str:
    """``file:line:col: error[TV501] name: message`` with the place and the hint below."""
    excerpts = Excerpts(sources, width)
    paint = _painter(color)
    return "\n".join(_text(d, excerpts, paint) for d in report.sorted())


def _painter(color: bool) -> Any:
    if color:
        return lambda style, text: f"\x1b[{style}m{text}\x1b[0m" if text else ""
    return lambda style, text: text


@dataclass(frozen=True, slots=True)
class _Mark:
    span: Span
    sign: str
    text: str
    style: str


def _marks(diagnostic: Diagnostic, style: str) -> list[_Mark]:
    """The places to show: those in the fault's own file by line, then the others."""
    own = diagnostic.span
    marks = [_Mark(own, "^", "", style)] if own is not None else []
    marks += [_Mark(label.span, "-", printable(label.text), _QUIET) for label in diagnostic.labels]
    here = [mark for mark in marks if own is not None and mark.span.file == own.file]
    return sorted(here, key=lambda mark: mark.span.line) + [m for m in marks if m not in here]


def _text(diagnostic: Diagnostic, excerpts: Excerpts, paint: Any) -> str:
    style = _STYLES[diagnostic.severity]
    place = f"{printable(str(diagnostic.span))}: " if diagnostic.span is not None else ""
    code = diagnostic.code
    head = paint(style, f"{diagnostic.severity.value}[{code.number}]")
    lines = [f"{place}{head} {code.name}: {paint('1', printable(diagnostic.message))}"]

    marks = _marks(diagnostic, style)
    gutter = excerpts.gutter([mark.span for mark in marks])
    blank = " " * gutter + paint(_QUIET, " |")
    shown: tuple[str, int, str] | None = None  # file, line and text of the line shown last
    for mark in marks:
        span, said = mark.span, f" {mark.text}" if mark.text else ""
        excerpt = excerpts.show(span, gutter)
        elsewhere = diagnostic.span is None or span.file != diagnostic.span.file
        if elsewhere or (excerpt is None and mark.text):
            arrow = paint(_QUIET, "-->")
            text = f":{said}" if excerpt is None else ""
            lines.append(f"{' ' * gutter} {arrow} {printable(str(span))}{text}")
        if excerpt is None:
            continue
        if shown is None:
            lines.append(blank)
        elif shown[0] == span.file and span.line > shown[1] + 1:
            lines.append(paint(_QUIET, "..."))
        if shown != (span.file, span.line, excerpt.text):
            number = paint(_QUIET, f"{span.line:>{gutter}} |")
            lines.append(f"{number} {excerpt.text}".rstrip())
        shown = (span.file, span.line, excerpt.text)
        marker = paint(mark.style, mark.sign * excerpt.length + said)
        lines.append(f"{blank} {' ' * excerpt.start}{marker}")
    if diagnostic.hint:
        lines.append(f"{' ' * gutter} {paint(_QUIET, '=')} hint: {printable(diagnostic.hint)}")
    lines.append("")
    return "\n".join(lines)


# -- json -------------------------------------------------------------------------------


def render_json(report: Report, *, builds: Sequence[Mapping[str, Any]] | None = None) -> str:
    """One object: ``errors`` and ``warnings`` (counts), ``diagnostics`` in order of place."""
    document: dict[str, Any] = {
        "errors": len(report.errors),
        "warnings": len(report.warnings),
        "diagnostics": [_json(d) for d in report.sorted()],
    }
    if builds is not None:
        document["builds"] = list(builds)
    return json_text(document)


def _json(diagnostic: Diagnostic) -> dict[str, Any]:
    return {
        "code": diagnostic.code.number,
        "name": diagnostic.code.name,
        "severity": diagnostic.severity.value,
        "message": diagnostic.message,
        "hint": diagnostic.hint,
        "span": _json_span(diagnostic.span),
        "labels": [
            {"text": label.text, "span": _json_span(label.span)} for label in diagnostic.labels
        ],
    }


def _json_span(span: Span | None) -> dict[str, Any] | None:
    if span is None:
        return None
    return {
        "file": span.file,
        "line": span.line,
        "column": span.column,
        "end_line": span.end_line,
        "end_column": span.end_column,
    }


# -- github -----------------------------------------------------------------------------

_GITHUB_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.NOTE: "notice"}


def render_github(report: Report) -> str:
    """Workflow commands, which GitHub shows beside the lines of a change."""
    return "\n".join(_github(d) for d in report.sorted())


def _github(diagnostic: Diagnostic) -> str:
    properties: dict[str, str] = {}
    span = diagnostic.span
    if span is not None:
        properties["file"] = printable(span.file)
        properties["line"] = str(span.line)
        properties["endLine"] = str(span.end_line)
        if span.end_line == span.line:  # columns of other spans are refused
            properties["col"] = str(span.column)
            properties["endColumn"] = str(max(span.end_column, span.column))
    properties["title"] = f"{diagnostic.code.number} {diagnostic.code.name}"
    listed = ",".join(f"{key}={_escaped(value, True)}" for key, value in properties.items())
    message = _escaped("\n".join(map(printable, _lines(diagnostic))), False)
    return f"::{_GITHUB_LEVELS[diagnostic.severity]} {listed}::{message}"


def _lines(diagnostic: Diagnostic) -> list[str]:
    """Message, labels and hint as lines of plain text."""
    lines = [diagnostic.message]
    lines += [f"{label.span}: {label.text}" for label in diagnostic.labels]
    if diagnostic.hint:
        lines.append(f"hint: {diagnostic.hint}")
    return lines


def _escaped(text: str, is_property: bool) -> str:
    text = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return text.replace(":", "%3A").replace(",", "%2C") if is_property else text
