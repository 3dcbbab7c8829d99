"""A calibration as text for people, as JSON, and as the document that a robot includes."""

from __future__ import annotations

import math
from typing import Any

from thorvaldc.runtime.calibration import CalibrationResult, Estimate


def as_json(result: CalibrationResult) -> dict[str, Any]:
    """The result as plain values: angles in rad, lengths in m."""

    def plain(estimate: Estimate | None) -> dict[str, Any] | None:
        if estimate is None:
            return None
        return {
            "value": estimate.value,
            "standard_error": estimate.error,
            "determined": estimate.determined,
        }

    return {
        "robot": result.robot,
        "duration": result.duration,
        "moving": result.moving,
        "scale": result.scale,
        "rolling_residual": result.rolling,
        "pointing_residual": result.pointing,
        "side_slip": result.slip,
        "iterations": result.iterations,
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


def table(result: CalibrationResult) -> str:
    """The wheels as aligned text with a heading; what is not determined has no value."""
    lines = [("wheel", "steering offset", "radius ratio", "radius")]
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
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _cell(estimate: Estimate | None, shown: Any, unit: str, size: Any) -> str:
    if estimate is None:
        return ""
    error = size(estimate.error)
    if not estimate.determined:
        return f"not determined (+-{error:.2g}{unit})"
    digits = 3 if unit else 5
    return f"{shown(estimate.value)} +- {error:.{digits}f}{unit}"


def overlay(result: CalibrationResult) -> str:
    """The calibration as a document for ``calibration`` in ``robot.yaml``.

    What the log does not determine keeps the value that it has there.
    """
    lines = ["thorvaldc: 1", f"robot: {result.robot}", "wheels:"]
    for wheel in result.wheels:
        entry: list[str] = []
        if wheel.radius is not None and wheel.ratio is not None:
            note = f"+- {wheel.radius * wheel.ratio.error * 1000:.3f} mm"
            if not wheel.ratio.determined:
                note = "not determined, as before"
            entry.append(f"    radius: {wheel.radius * 1000:.4f} mm  # {note}")
        offset = wheel.offset
        if offset is not None and offset.determined:
            degrees = math.degrees(offset.value)
            note = f"+- {math.degrees(offset.error):.3f} deg"
            entry.append(f"    steering_offset: {degrees:.4f} deg  # {note}")
        elif offset is not None and wheel.present_offset:
            degrees = math.degrees(wheel.present_offset)
            entry.append(f"    steering_offset: {degrees:.6g} deg  # not determined, as before")
        if entry:
            lines += [f"  {wheel.name}:", *entry]
    if len(lines) == 3:
        lines[2] = "wheels: {}"
    return "\n".join(lines) + "\n"
