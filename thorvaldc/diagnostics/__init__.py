"""Diagnostic codes, source spans, reports of diagnostics, and their output formats."""

from thorvaldc.diagnostics.codes import CODES, Code
from thorvaldc.diagnostics.report import (
    FIRST_USE,
    Accepted,
    Diagnostic,
    DiagnosticError,
    Fix,
    Label,
    OutsideError,
    Proposal,
    Report,
    Severity,
    Span,
    did_you_mean,
    millimetres,
    nearest,
    plain,
)

__all__ = [
    "CODES",
    "FIRST_USE",
    "Accepted",
    "Code",
    "Diagnostic",
    "DiagnosticError",
    "Fix",
    "Label",
    "OutsideError",
    "Proposal",
    "Report",
    "Severity",
    "Span",
    "did_you_mean",
    "millimetres",
    "nearest",
    "plain",
]
