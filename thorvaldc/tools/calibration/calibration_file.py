"""Writes the calibration file of a robot, and keeps present values that were not estimated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from thorvaldc.compiler.robot_settings.wheel_calibration import load_calibration
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.atomic_file import write_file
from thorvaldc.tools.calibration.calibration_text import overlay
from thorvaldc.tools.calibration.self_calibration import CalibrationResult


def overlay_text(result: CalibrationResult, robot: Path) -> str:
    """Returns the text of a calibration file with the estimated radii and steering offsets.

    Radii and offsets that were not estimated are copied from the calibration file that the robot
    file includes.
    """
    return overlay(result, *_present_values(robot))


def _present_values(robot: Path) -> tuple[dict[str, dict[str, Any]], dict[str, float]]:
    """Returns the present calibration of each wheel by its name, and the noise, in SI units.

    The calibration is read from the calibration file that the robot file includes.  Both
    dictionaries are empty if the robot file includes no calibration file.
    """
    document = read_file(robot, robot.name, Report())
    calibration = load_calibration(document, robot.parent, Report(), {}) if document else None
    if calibration is None:
        return {}, {}
    wheels: dict[str, dict[str, Any]] = {name: {} for name in calibration.names}
    for name, (value, _) in calibration.radii.items():
        wheels[name]["radius"] = value
    for name, named_radii in calibration.named_radii.items():
        wheels[name]["radii"] = {key: value for key, (value, _) in named_radii.items()}
    for name, (value, _) in calibration.steering_offsets.items():
        wheels[name]["steering_offset"] = value
    return wheels, calibration.noise


def write_calibration(path: Path, text: str) -> None:
    """Writes the text of a calibration file to ``path``.

    The calibration file is either written completely or not changed.  Raises ``FileExistsError`` if
    ``path`` is an existing file that is not a calibration file.
    """
    if path.exists() and not _is_calibration(path):
        raise FileExistsError(f"will not overwrite {path}, which is no calibration")
    write_file(path, text)


def _is_calibration(path: Path) -> bool:
    document = read_file(path, path.name, Report())
    return (
        document is not None
        and document.get("robot") is not None
        and document.get("wheels") is not None
    )
