"""Reads the model.json of a build."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.fleet import Fleet
from thorvaldc.model.robot import Robot
from thorvaldc.model.serialize import ModelFormatError, from_json


def load_model(build: Path) -> Robot | Fleet:
    """The model of a build folder.  Raises ``DiagnosticError`` (``model-unreadable``)."""
    path = build / "model.json"
    try:
        return from_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as fault:
        raise DiagnosticError(
            "model-unreadable",
            f"cannot read {path}: {getattr(fault, 'strerror', None) or 'not UTF-8 text'}",
            hint="build the robot first: thorvaldc build",
        ) from fault
    except ModelFormatError as fault:
        raise DiagnosticError(
            "model-unreadable", f"{path}: {fault}", hint="build the robot again"
        ) from fault
