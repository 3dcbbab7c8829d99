"""Reads the ``model.json`` of a build folder."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.fleet import Fleet
from thorvaldc.model.robot import Robot
from thorvaldc.model.serialize import ModelFormatError, from_json


def load_model(build: Path) -> Robot | Fleet:
    """Return the model of a build folder.  Raises ``DiagnosticError`` (``model-unreadable``)."""
    path = build / "model.json"
    try:
        return from_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise DiagnosticError(
            "model-unreadable",
            f"cannot read {path}: {getattr(error, 'strerror', None) or 'not UTF-8 text'}",
            hint="build the robot first: thorvaldc build",
        ) from error
    except ModelFormatError as error:
        raise DiagnosticError(
            "model-unreadable", f"{path}: {error}", hint="build the robot again"
        ) from error
