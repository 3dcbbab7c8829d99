"""Calibration results as a table, as JSON, and as the calibration file of a robot."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from thorvaldc.commissioning import commission_report
from thorvaldc.compiler.result import SourceFile
from thorvaldc.compiler.robot_settings.wheel_calibration import Calibration, load_calibration
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.files import write_file
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.tools.calibration import self_calibration as calibration

_UNCHANGED = "as before"


def as_json(result: calibration.CalibrationResult) -> dict[str, Any]:
    """Returns the calibration result as a dictionary for JSON, in rad and m."""

    def plain(estimate: calibration.Estimate | None) -> dict[str, Any] | None:
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

    def motions(plan: calibration.MotionPlan) -> list[dict[str, Any]] | None:
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


def as_report(result: calibration.CalibrationResult) -> commission_report.CalibrationResult:
    """Returns the calibration result for the report of the robot's first motion."""

    def measured(estimate: calibration.Estimate | None) -> tuple[float | None, float | None]:
        if estimate is None or not estimate.determined:
            return None, None
        return estimate.value, estimate.error

    return commission_report.CalibrationResult(
        tuple(
            commission_report.CalibratedWheel(w.name, *measured(w.offset), *measured(w.ratio))
            for w in result.wheels
        ),
        tuple(
            commission_report.LastingError(name, value)
            for name, value in result.remaining_errors.items()
        ),
    )


def table(result: calibration.CalibrationResult, width: int | None = None) -> str:
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
                _cell(offset, lambda v: f"{math.degrees(v):+z.3f}", " deg", math.degrees),
                _cell(ratio, lambda v: f"{v:.5f}", "", float),
                "" if wheel.radius is None else f"{wheel.radius * 1000:.2f} mm",
            )
        )
    noise = (
        f"noise of this log: {{speed_ratio: {100.0 * result.rolling:.3f} %, "
        f"angle: {math.degrees(result.pointing):.3f} deg, correlation: {result.correlation:.2f} s}}"
    )
    return "\n".join([text_table(lines, width, right=(1, 2, 3)), noise])


def _cell(estimate: calibration.Estimate | None, format_value: Any, unit: str, convert: Any) -> str:
    if estimate is None:
        return ""
    if not (estimate.determined or estimate.coarse):
        return f"not determined (+-{convert(estimate.error):.2g}{unit})"
    digits = 3 if unit else 5
    errors = [convert(error) for error in (estimate.random, estimate.systematic)]
    text = " +- ".join([format_value(estimate.value), *(f"{e:.{digits}f}" for e in errors)]) + unit
    return text if estimate.determined else f"({text}) {_UNCHANGED}"


def overlay(result: calibration.CalibrationResult, present: Calibration | None = None) -> str:
    """Returns the text of a calibration file that ``robot.yaml`` can include.

    ``present``: the calibration that ``robot.yaml`` includes now.  Values that the joint log does
    not determine are copied from it.
    """
    present = present or Calibration()
    lines = []
    for wheel in result.wheels:
        scaled = result.scale is not None
        entry = [*_radii(wheel, present, scaled=scaled), *_offset(wheel, present)]
        if entry:
            lines += [f"  {wheel.name}:", *(f"    {line}" for line in entry)]
    header = ["thorvaldc: 1", f"robot: {result.robot}"]
    noise = dict(present.noise)
    if not any(wheel.named for wheel in result.wheels):
        noise |= result.remaining_errors
    if noise:
        header.append("noise:  # errors that remain")
    for key, value in noise.items():
        angle = key == "steering_offset_error"
        text = f"{math.degrees(value):.4f} deg" if angle else f"{100.0 * value:.4f} %"
        header.append(f"  {key}: {text}")
    return "\n".join([*header, *(["wheels:", *lines] if lines else ["wheels: {}"])]) + "\n"


def _radii(
    wheel: calibration.WheelCalibration, present: Calibration, *, scaled: bool
) -> Iterator[str]:
    ordinary = present.radii.get(wheel.name)
    measured = {"": ordinary} if ordinary is not None else {}
    measured |= present.named_radii.get(wheel.name, {})
    values = {name: value for name, (value, _) in measured.items()}
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


def _offset(wheel: calibration.WheelCalibration, present: Calibration) -> Iterator[str]:
    offset = wheel.offset
    if offset is not None and offset.determined:
        errors = _errors(math.degrees(offset.random), math.degrees(offset.systematic), "deg")
        yield f"steering_offset: {math.degrees(offset.value):.4f} deg  # {errors}"
    elif wheel.name in present.steering_offsets:
        value, _ = present.steering_offsets[wheel.name]
        yield f"steering_offset: {math.degrees(value):.6g} deg  # {_UNCHANGED}"


def overlay_text(result: calibration.CalibrationResult, robot: Path) -> str:
    """Returns the text of a calibration file with the estimated radii and steering offsets.

    Radii and offsets that were not estimated are copied from the calibration file that the robot
    file includes.
    """
    source = SourceFile(robot, robot.name, robot.parent)
    document, files = source.document, source.files
    present = load_calibration(document, robot.parent, Report(), files) if document else None
    return overlay(result, present)


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
    return document is not None and all(document.get(key) for key in ("robot", "wheels"))
