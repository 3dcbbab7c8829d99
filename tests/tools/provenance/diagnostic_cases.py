"""Runs the cases of tests/diagnostics that explain the value ``path``."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.tools.provenance.explanation import Explainer


def _explain(case: dict[str, Any], entry: str) -> Report:
    compilation = compile_file(entry)
    assert isinstance(compilation.model, Robot)
    with ExitStack() as stack:
        try:
            Explainer(Path(entry), compilation.model, [], False, stack).explain(case["path"])
        except DiagnosticError as error:
            compilation.report.put(error.diagnostic)
    return compilation.report


COMMANDS = {"why": _explain}
