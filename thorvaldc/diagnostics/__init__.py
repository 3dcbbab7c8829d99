"""Diagnostic codes, source spans, reports of diagnostics, and their output formats."""

from thorvaldc.diagnostics.codes import CODES, Code
from thorvaldc.diagnostics.report import (
    Accepted,
    Diagnostic,
    Fix,
    Label,
    Proposal,
    Report,
    Severity,
    Span,
)

__all__ = [
    "CODES",
    "Accepted",
    "Code",
    "Diagnostic",
    "Fix",
    "Label",
    "Proposal",
    "Report",
    "Severity",
    "Span",
]
