"""Diagnostic codes, source spans, reports, and renderers of reports."""

from thorvaldc.diagnostics.codes import CODES, Code
from thorvaldc.diagnostics.report import Diagnostic, Label, Report, Severity, Span

__all__ = ["CODES", "Code", "Diagnostic", "Label", "Report", "Severity", "Span"]
