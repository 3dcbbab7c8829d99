"""Faults as values: codes, spans, the report that collects them, its renderers."""

from thorvaldc.diagnostics.codes import CODES, Code
from thorvaldc.diagnostics.report import Diagnostic, Label, Report, Severity, Span

__all__ = ["CODES", "Code", "Diagnostic", "Label", "Report", "Severity", "Span"]
