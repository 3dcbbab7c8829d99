"""Calibration results as a table, as JSON, and as the calibration file of a robot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from thorvaldc.compiler.robot_settings.wheel_calibration import load_calibration
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.atomic_file import write_file
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.tools.calibration.self_calibration import (
    CalibrationResult,
    Estimate,
    MotionPlan,
    WheelCalibration,
)

_UNCHANGED = "as before"


def as_json(result: CalibrationResult) -> dict[str, Any]:
    """Returns the calibration result as a dictionary for JSON, in rad and m."""

    def plain(estimate: Estimate | None) -> dict[str, Any] | None:
        if estimate is None:
            return None
        return {
            "value": estimate.value,
            "standard_error": estimate.error,
            "random_error": estimate.random,
            "systematic_error": estimate.systematic,
            "determined": estimate.determined,
            "settled": estimate.settled,
        }

    def motions(plan: MotionPlan) -> list[dict[str, Any]] | None:
        if plan is None:
            return None
        return [{"motion": motion.description, "seconds": motion.seconds} for motion in plan]

    return {
        "robot": result.robot,
        "duration": result.duration,
        "moving": result.moving,
        "scale": result.scale,
        "rolling_residual": result.rolling,
        "pointing_residual": result.pointing,
        "side_slip": result.slip,
        "iterations": result.iterations,
        "correlation": result.correlation,
        "remaining_errors": dict(result.remaining_errors),
        "steering_offset_plan": motions(result.offset_plan),
        "radius_ratio_plan": motions(result.ratio_plan),
        "wheels": [
            {
                "name": wheel.name,
                "steering_offset": plain(wheel.offset),
                "radius_ratio": plain(wheel.ratio),
                "radius": wheel.radius,
            }
            for wheel in result.wheels
        ],
    }


def table(result: CalibrationResult, width: int | None = None) -> str:
    """Returns the calibration result as a text table with one line per wheel.

    Each value has a random and a systematic standard error.  Radii and steering offsets that the
    robot does not take over are marked.  The last line is the noise of the log, as a section of
    ``robot.yaml``.  ``width``: number of columns of the terminal, or ``None`` for one line per
    wheel.
    """
    errors = "+- random +- systematic"
    lines = [("wheel", f"steering offset {errors}", f"radius ratio {errors}", "radius")]
    for wheel in result.wheels:
        offset, ratio = wheel.offset, wheel.ratio
        lines.append(
            (
                wheel.name,
                _cell(offset, lambda v: f"{math.degrees(v):+.3f}", " deg", math.degrees),
                _cell(ratio, lambda v: f"{v:.5f}", "", float),
                "" if wheel.radius is None else f"{wheel.radius * 1000:.2f} mm",
            )
        )
    noise = (
        f"noise of this log: {{speed_ratio: {100.0 * result.rolling:.3f} %, "
        f"angle: {math.degrees(result.pointing):.3f} deg, correlation: {result.correlation:.2f} s}}"
    )
    return "\n".join([text_table(lines, width, right=(1, 2, 3)), noise])


def _cell(estimate: Estimate | None, format_value: Any, unit: str, convert: Any) -> str:
    if estimate is None:
        return ""
    if not (estimate.determined or estimate.coarse):
        return f"not determined (+-{convert(estimate.error):.2g}{unit})"
    digits = 3 if unit else 5
    errors = [convert(error) for error in (estimate.random, estimate.systematic)]
    text = " +- ".join([format_value(estimate.value), *(f"{e:.{digits}f}" for e in errors)]) + unit
    return text if estimate.determined else f"({text}) {_UNCHANGED}"


Values = Mapping[str, Any]
"""Calibration values of a wheel, in SI units.

The keys of the dictionary are ``radius``, ``radii`` (radii by name) and ``steering_offset``.
"""


def overlay(
    result: CalibrationResult,
    previous: Mapping[str, Values] | None = None,
    previous_noise: Mapping[str, float] | None = None,
) -> str:
    """Returns the text of a calibration document that ``robot.yaml`` can include.

    ``previous`` and ``previous_noise`` contain the calibration that ``robot.yaml`` includes now.
    Values that the joint log does not determine are copied from them.
    """
    lines = []
    for wheel in result.wheels:
        old = (previous or {}).get(wheel.name, {})
        entry = [*_radii(wheel, old, scaled=result.scale is not None), *_offset(wheel, old)]
        if entry:
            lines += [f"  {wheel.name}:", *(f"    {line}" for line in entry)]
    header = ["thorvaldc: 1", f"robot: {result.robot}"]
    noise = dict(previous_noise or {})
    if not any(wheel.named for wheel in result.wheels):
        noise |= result.remaining_errors
    if noise:
        header.append("noise:  # errors that remain")
    for key, value in noise.items():
        angle = key == "steering_offset_error"
        text = f"{math.degrees(value):.4f} deg" if angle else f"{100.0 * value:.4f} %"
        header.append(f"  {key}: {text}")
    return "\n".join([*header, *(["wheels:", *lines] if lines else ["wheels: {}"])]) + "\n"


def _radii(wheel: WheelCalibration, old: Values, *, scaled: bool) -> Iterator[str]:
    values = {"": old["radius"]} if "radius" in old else {}
    values |= old.get("radii", {})
    notes = dict.fromkeys(values, _UNCHANGED)
    if wheel.radius is not None and wheel.ratio is not None:
        determined = wheel.ratio.determined
        if determined or scaled:
            values[wheel.named] = wheel.radius
            scale = wheel.radius * 1000
            error = _errors(scale * wheel.ratio.random, scale * wheel.ratio.systematic, "mm")
            notes[wheel.named] = error if determined else "by the common scale alone"
    if "" in values:
        yield f"radius: {values.pop('') * 1000:.4f} mm  # {notes['']}"
    if values:
        yield "radii:"
    for name, value in values.items():
        yield f"  {name}: {value * 1000:.4f} mm  # {notes[name]}"


def _errors(random: float, systematic: float, unit: str) -> str:
    return f"+- {random:.3f} {unit} random, +- {systematic:.3f} {unit} systematic"


def _offset(wheel: WheelCalibration, old: Values) -> Iterator[str]:
    offset = wheel.offset
    if offset is not None and offset.determined:
        errors = _errors(math.degrees(offset.random), math.degrees(offset.systematic), "deg")
        yield f"steering_offset: {math.degrees(offset.value):.4f} deg  # {errors}"
    elif "steering_offset" in old:
        yield f"steering_offset: {math.degrees(old['steering_offset']):.6g} deg  # {_UNCHANGED}"


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
