"""Formats a report of diagnostics as text, JSON, GitHub workflow commands or SARIF.

The parameter ``sources`` maps each file name in the source spans to the path of the file.  If a
file is not in ``sources``, the text output shows no source lines of the file.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from thorvaldc import __version__
from thorvaldc.diagnostics.codes import Code, page
from thorvaldc.diagnostics.report import Accepted, Diagnostic, Fix, Report, Severity, Span
from thorvaldc.diagnostics.source_excerpt import UNPRINTABLE, Excerpts
from thorvaldc.diagnostics.text_layout import preformatted

FORMATS = ("text", "json", "github", "sarif")

_STYLES = {
    Severity.ERROR: "1;31",
    Severity.WARNING: "1;33",
    Severity.NOTE: "1;36",
}
_LABEL_STYLE = "1;34"
MAX_SHOWN = 50
"""Number of diagnostics in the text for people."""
_HIGH_CONTROLS = re.compile("[\x7f-\x9f\u2028\u2029]")


def render(
    report: Report,
    format: str,
    sources: Mapping[str, Path] | None = None,
    **results: Sequence[Mapping[str, Any]],
) -> str:
    """Returns a report of diagnostics as text without colours.

    - ``format``: output format, one of ``FORMATS``.
    - ``sources``: path of each file name in the source spans.
    - ``results``: lists of what the command made.  Only the JSON output contains them.
    """
    if format == "json":
        return render_json(report, **results)
    if format == "github":
        return render_github(report)
    if format == "badge":
        return render_badge(report)
    if format == "sarif":
        return render_sarif(report)
    return render_text(report, sources or {})


def printable(text: str) -> str:
    """Returns a text in which line breaks and control characters are replaced by escape sequences.

    Control characters in a message could change the colours or the cursor of a terminal.
    """
    return UNPRINTABLE.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def json_text(document: Any) -> str:
    """Returns a Python value as indented JSON text without control characters."""
    text = json.dumps(document, indent=2, ensure_ascii=False)
    # The module `json` escapes the C0 control characters.  Control characters outside C0 occur only
    # inside strings of the JSON text, where an escape sequence is valid.
    return _HIGH_CONTROLS.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


# -- text -------------------------------------------------------------------------------


def render_text(
    report: Report, sources: Mapping[str, Path], *, color: bool = False, width: int = 100
) -> str:
    """Returns a report of diagnostics as text for a terminal.

    Each diagnostic begins with a line ``file:line:column: error[TV501] name: message``.  The text
    of a diagnostic also contains the invalid source lines and the hint.  At most ``MAX_SHOWN``
    diagnostics are shown, errors before others, followed by the number of those left out.

    - ``color``: whether the text contains ANSI escape sequences for colours.
    - ``width``: maximum width of a source line in terminal columns.
    """
    excerpts = Excerpts(sources, width)
    paint = _painter(color)
    diagnostics = report.sorted()
    by_severity = sorted(diagnostics, key=lambda d: d.severity is not Severity.ERROR)
    left_out = by_severity[MAX_SHOWN:]
    hidden = {id(d) for d in left_out}
    texts = [_text(d, excerpts, paint) for d in diagnostics if id(d) not in hidden]
    if left_out:
        errors = len([d for d in left_out if d.severity is Severity.ERROR])
        counts = [(errors, "more errors"), (len(left_out) - errors, "more warnings or notes")]
        more = " and ".join(f"{n} {kind}" for n, kind in counts if n)
        texts.append(f"not shown: {more}; `thorvaldc check --format json` lists all\n")
    return "\n".join(texts)


def render_html(report: Report) -> str:
    """Returns a report for a notebook, without excerpts."""
    return preformatted(f"{report.summary()}\n{render_text(report, {})}")


def render_accepted(report: Report, *, color: bool = False) -> str:
    """Returns the accepted warnings of a report as text, each with the user's reason."""
    paint = _painter(color)
    lines: list[str] = []
    for diagnostic, reason, span in report.accepted:
        place = f"{diagnostic.span}: " if diagnostic.span is not None else ""
        title = paint(_LABEL_STYLE, f"accepted[{diagnostic.code.number}] {diagnostic.code.name}")
        lines += [f"{place}{title}: {diagnostic.message}", f"  = reason: {reason} ({span})", ""]
    return "\n".join(lines)


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
    """Returns the source spans that the output shows for a diagnostic, in the order of output.

    Source spans in the file of the diagnostic come first, in the order of their lines.  Source
    spans in other files come last.
    """
    span = diagnostic.span
    marks = [_Mark(span, "^", "", style)] if span is not None else []
    marks += [
        _Mark(label.span, "-", printable(label.text), _LABEL_STYLE) for label in diagnostic.labels
    ]
    same_file = [mark for mark in marks if span is not None and mark.span.file == span.file]
    same_file.sort(key=lambda mark: mark.span.line)
    return same_file + [mark for mark in marks if mark not in same_file]


def _text(diagnostic: Diagnostic, excerpts: Excerpts, paint: Any) -> str:
    style = _STYLES[diagnostic.severity]
    location = f"{printable(str(diagnostic.span))}: " if diagnostic.span is not None else ""
    code = diagnostic.code
    head = paint(style, f"{diagnostic.severity.value}[{code.number}]")
    lines = [f"{location}{head} {code.name}: {paint('1', printable(diagnostic.message))}"]

    marks = _marks(diagnostic, style)
    gutter = excerpts.gutter([mark.span for mark in marks])
    blank = " " * gutter + paint(_LABEL_STYLE, " |")
    previous: tuple[str, int, str] | None = None  # file, line number and text of the last line
    for mark in marks:
        span, label = mark.span, f" {mark.text}" if mark.text else ""
        excerpt = excerpts.show(span, gutter)
        other_file = diagnostic.span is None or span.file != diagnostic.span.file
        if other_file or (excerpt is None and mark.text):
            arrow = paint(_LABEL_STYLE, "-->")
            text = f":{label}" if excerpt is None else ""
            lines.append(f"{' ' * gutter} {arrow} {printable(str(span))}{text}")
        if excerpt is None:
            continue
        if previous is None:
            lines.append(blank)
        elif previous[0] == span.file and span.line > previous[1] + 1:
            lines.append(paint(_LABEL_STYLE, "..."))
        if previous != (span.file, span.line, excerpt.text):
            number = paint(_LABEL_STYLE, f"{span.line:>{gutter}} |")
            lines.append(f"{number} {excerpt.text}".rstrip())
        previous = (span.file, span.line, excerpt.text)
        marker = paint(mark.style, mark.sign * excerpt.length + label)
        lines.append(f"{blank} {' ' * excerpt.start}{marker}")
    if diagnostic.hint:
        lines.append(
            f"{' ' * gutter} {paint(_LABEL_STYLE, '=')} hint: {printable(diagnostic.hint)}"
        )
    lines.append("")
    return "\n".join(lines)


# -- json -------------------------------------------------------------------------------


def render_json(report: Report, **results: Sequence[Mapping[str, Any]]) -> str:
    """Returns a report of diagnostics as a JSON object.

    The JSON keys ``errors`` and ``warnings`` contain the numbers of errors and warnings.  The JSON
    key ``diagnostics`` contains the list of the diagnostics in the order of file, line and column.
    The JSON key ``accepted`` contains the accepted warnings, which are not in the other list.
    The JSON object also contains the lists ``results`` under their names.
    """
    document: dict[str, Any] = {
        "errors": len(report.errors),
        "warnings": len(report.warnings),
        "diagnostics": [_json(d) for d in report.sorted()],
        "accepted": [
            _json(diagnostic) | {"reason": reason, "accepted_at": _json_span(span)}
            for diagnostic, reason, span in report.accepted
        ],
        **results,
    }
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
        "fixes": [
            {"text": fix.text, "span": _json_span(fix.span), "is_example": fix.is_example}
            for fix in diagnostic.fixes
        ],
    }


def _json_span(span: Span | None) -> dict[str, Any] | None:
    return None if span is None else span._asdict()


def render_badge(report: Report) -> str:
    """Returns the numbers of errors and warnings as the JSON of a shields.io endpoint badge."""
    errors, warnings = len(report.errors), len(report.warnings)
    color = "red" if errors else "yellow" if warnings else "brightgreen"
    message = report.summary() if errors or warnings else "no errors"
    badge = {"schemaVersion": 1, "label": "thorvaldc check", "message": message, "color": color}
    return json_text(badge)


# -- github -----------------------------------------------------------------------------

_GITHUB_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.NOTE: "notice"}


def render_github(report: Report) -> str:
    """Returns a report of diagnostics as GitHub workflow commands.

    GitHub shows each workflow command as an annotation in the list of changed files.
    """
    return "\n".join(_github(d) for d in report.sorted())


def _github(diagnostic: Diagnostic) -> str:
    properties: dict[str, str] = {}
    span = diagnostic.span
    if span is not None:
        properties["file"] = printable(span.file)
        properties["line"] = str(span.line)
        properties["endLine"] = str(span.end_line)
        if span.end_line == span.line:  # GitHub accepts column numbers only in one line
            properties["col"] = str(span.column)
            properties["endColumn"] = str(max(span.end_column, span.column))
    properties["title"] = f"{diagnostic.code.number} {diagnostic.code.name}"
    listed = ",".join(f"{key}={_escaped(value, True)}" for key, value in properties.items())
    message = _escaped("\n".join(map(printable, _lines(diagnostic))), False)
    return f"::{_GITHUB_LEVELS[diagnostic.severity]} {listed}::{message}"


def _lines(diagnostic: Diagnostic) -> list[str]:
    """Returns the message, the labels and the hint of a diagnostic as lines of plain text."""
    lines = [diagnostic.message]
    lines += [f"{label.span}: {label.text}" for label in diagnostic.labels]
    if diagnostic.hint:
        lines.append(f"hint: {diagnostic.hint}")
    return lines


def _escaped(text: str, is_property: bool) -> str:
    text = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return text.replace(":", "%3A").replace(",", "%2C") if is_property else text


# -- sarif: version 2.1.0, for code scanning services and editors ------------------------

SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


def render_sarif(report: Report) -> str:
    """Returns a report of diagnostics as a SARIF document with one run.

    In the SARIF document, each diagnostic code of the report is a rule.  The documentation page of
    a diagnostic code is the help text of the SARIF rule.
    """
    diagnostics = report.sorted()
    shown = [*diagnostics, *(a.diagnostic for a in report.accepted)]
    codes = sorted({d.code.number: d.code for d in shown}.values(), key=lambda c: c.number)
    index = {code.number: i for i, code in enumerate(codes)}
    document = {
        "$schema": SARIF_SCHEMA,
        "version": "2.1.0",
        "runs": [
            {
                "tool": {
                    "driver": {
                        "name": "thorvaldc",
                        "semanticVersion": __version__,
                        "rules": [_rule(code) for code in codes],
                    }
                },
                "columnKind": "unicodeCodePoints",
                "results": [
                    *(_result(d, index) for d in diagnostics),
                    *(_accepted_result(a, index) for a in report.accepted),
                ],
            }
        ],
    }
    return json_text(document)


def _rule(code: Code) -> dict[str, Any]:
    text = page(code)
    return {
        "id": code.number,
        "name": "".join(word.capitalize() for word in code.name.split("-")),
        "shortDescription": {"text": f"{code.name}: {code.summary}"},
        "help": {"text": text, "markdown": text},
        "defaultConfiguration": {"level": code.severity},
    }


def _result(diagnostic: Diagnostic, index: dict[str, int]) -> dict[str, Any]:
    message = diagnostic.message
    if diagnostic.hint:
        message += f"\nhint: {diagnostic.hint}"
    result: dict[str, Any] = {
        "ruleId": diagnostic.code.number,
        "ruleIndex": index[diagnostic.code.number],
        "level": diagnostic.severity.value,
        "message": {"text": message},
    }
    if diagnostic.span is not None:
        result["locations"] = [{"physicalLocation": _physical_location(diagnostic.span)}]
    if diagnostic.labels:
        result["relatedLocations"] = [
            {
                "id": number,
                "physicalLocation": _physical_location(label.span),
                "message": {"text": label.text},
            }
            for number, label in enumerate(diagnostic.labels, 1)
        ]
    if diagnostic.fixes:
        result["fixes"] = [_sarif_fix(fix) for fix in diagnostic.fixes]
    return result


def _accepted_result(accepted: Accepted, index: dict[str, int]) -> dict[str, Any]:
    """Returns an accepted warning as a result that is suppressed in the source."""
    suppression = {
        "kind": "inSource",
        "status": "accepted",
        "justification": accepted.reason,
        "location": {"physicalLocation": _physical_location(accepted.span)},
    }
    return _result(accepted.diagnostic, index) | {"suppressions": [suppression]}


def _sarif_fix(fix: Fix) -> dict[str, Any]:
    replacement = {"deletedRegion": _sarif_region(fix.span), "insertedContent": {"text": fix.text}}
    location = {"uri": _uri(fix.span.file)}
    return {"artifactChanges": [{"artifactLocation": location, "replacements": [replacement]}]}


def _physical_location(span: Span) -> dict[str, Any]:
    return {"artifactLocation": {"uri": _uri(span.file)}, "region": _sarif_region(span)}


def _sarif_region(span: Span) -> dict[str, int]:
    return {
        "startLine": span.line,
        "startColumn": span.column,
        "endLine": span.end_line,
        "endColumn": span.end_column,
    }


def _uri(file: str) -> str:
    path = file.replace(os.sep, "/")
    return ("file://" if path.startswith("/") else "") + quote(path)
