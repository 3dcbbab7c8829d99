"""Robots to start from: robot files of the templates."""

from __future__ import annotations

import re
from pathlib import Path

from thorvaldc.compiler.library import data_folder

_NAME = re.compile(r"[a-z][a-z0-9_]*")


def is_robot_name(name: str) -> bool:
    """Whether a robot can have this name: small letters, digits and _, a letter first."""
    return _NAME.fullmatch(name) is not None


def presets() -> list[str]:
    """Returns the names of the templates."""
    return sorted(path.stem for path in _templates().glob("*.yaml"))


def robot_text(name: str, preset: str) -> str:
    """Returns the text of a robot.yaml."""
    return (_templates() / f"{preset}.yaml").read_text(encoding="utf-8").replace("@NAME@", name)


def _templates() -> Path:
    return data_folder("templates") / "robot"
