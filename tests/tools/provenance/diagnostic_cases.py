"""Runs the cases of tests/diagnostics that explain the value ``path``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.tools.provenance.explanation import Explainer
from thorvaldc.tools.provenance.trace import Trace


def _explain(case: dict[str, Any], entry: str) -> Report:
    report = compile_file(entry).report
    try:
        Explainer(Trace(Path(entry))).explain(case["path"])
    except DiagnosticError as error:
        report.put(error.diagnostic)
    return report


COMMANDS = {"why": _explain}
