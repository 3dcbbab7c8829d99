"""Runs the cases of tests/diagnostics that fetch the libraries of ``entry``."""

from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path
from typing import Any
from unittest import mock

from thorvaldc.cli.diagnostic_output import DiagnosticOutput
from thorvaldc.diagnostics import Report
from thorvaldc.tools.library_fetch.fetch_command import fetch_libraries


class _Diagnostics(DiagnosticOutput):
    """Keeps the diagnostics and prints nothing."""

    def __init__(self) -> None:
        super().__init__("json", io.StringIO())
        self.report = Report()

    def add(self, report: Report, sources: Any) -> None:
        self.report.extend(report)


def _fetch(case: dict[str, Any], entry: str) -> Report:
    """The files in the folder ``agri`` are also those of the archive ``agri.zip``."""
    with zipfile.ZipFile("agri.zip", "w") as archive:
        for path in sorted(Path("agri").rglob("*")):
            archive.write(path, path.relative_to("agri"))
    output = _Diagnostics()
    with mock.patch.dict(os.environ, {"XDG_CACHE_HOME": str(Path("cache").resolve())}):
        fetch_libraries(Path(entry), False, output)
    return output.report


COMMANDS = {"fetch": _fetch}
