"""Runs the cases of tests/diagnostics that import."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from thorvaldc.diagnostics import Report
from thorvaldc.tools.importer.original_import import import_original
from thorvaldc.tools.importer.urdf_import import import_urdf


def _import(case: dict[str, Any], entry: str) -> Report:
    path = Path(entry)
    return (import_urdf(path) if path.suffix == ".urdf" else import_original(path)).report


COMMANDS = {"import": _import}
