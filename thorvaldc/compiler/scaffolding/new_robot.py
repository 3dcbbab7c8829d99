"""Creates the text of a new robot file from a template."""

from __future__ import annotations

import re
from pathlib import Path

from thorvaldc.model.data_folder import data_folder

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


def is_robot_name(name: str) -> bool:
    """Returns whether a text is a valid name of a robot.

    A robot name contains lower case letters, digits and underscores, and begins with a letter.
    """
    return _NAME.fullmatch(name) is not None


def presets() -> list[str]:
    """Returns the sorted names of the templates for robot files."""
    return sorted(path.stem for path in _templates().glob("*.yaml"))


def robot_text(name: str, preset: str) -> str:
    """Returns the text of a new robot file that contains the robot name ``name``.

    ``preset`` is the name of the template for the new robot file.
    """
    return (_templates() / f"{preset}.yaml").read_text(encoding="utf-8").replace("@NAME@", name)


def _templates() -> Path:
    return data_folder("templates") / "robot"
