"""Formats a report of diagnostics as SARIF 2.1.0, for code scanning services and editors."""

from __future__ import annotations

import os
from typing import Any
from urllib.parse import quote

from thorvaldc import __version__
from thorvaldc.diagnostics import explain
from thorvaldc.diagnostics.codes import Code
from thorvaldc.diagnostics.excerpt import json_text
from thorvaldc.diagnostics.report import Accepted, Diagnostic, Fix, Report, Span

SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


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
        "$schema": SCHEMA,
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
    page = explain.page(code)
    return {
        "id": code.number,
        "name": "".join(word.capitalize() for word in code.name.split("-")),
        "shortDescription": {"text": f"{code.name}: {code.summary}"},
        "help": {"text": page, "markdown": page},
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
        result["fixes"] = [_fix(fix) for fix in diagnostic.fixes]
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


def _fix(fix: Fix) -> dict[str, Any]:
    replacement = {"deletedRegion": _region(fix.span), "insertedContent": {"text": fix.text}}
    location = {"uri": _uri(fix.span.file)}
    return {"artifactChanges": [{"artifactLocation": location, "replacements": [replacement]}]}


def _physical_location(span: Span) -> dict[str, Any]:
    return {"artifactLocation": {"uri": _uri(span.file)}, "region": _region(span)}


def _region(span: Span) -> dict[str, int]:
    return {
        "startLine": span.line,
        "startColumn": span.column,
        "endLine": span.end_line,
        "endColumn": span.end_column,
    }


def _uri(file: str) -> str:
    path = file.replace(os.sep, "/")
    return ("file://" if path.startswith("/") else "") + quote(path)
