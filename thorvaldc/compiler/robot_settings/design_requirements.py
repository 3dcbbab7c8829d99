"""Reads the requirements on the whole robot from the `design` section of a robot document."""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import Report, Span

DEFAULT_TIP_OVER = math.radians(15)


class DesignRequirements(NamedTuple):
    """Requirements on a whole robot, such as the slope that the robot must climb.

    Attributes
    ----------
    slope : slope (rad) that the robot must climb.  ``None`` if no slope is required.
    tip_over_angle : least tip-over angle (rad) of the robot.
    slope_span : span of the entry for the slope.
    tip_over_span : span of the entry for the tip-over angle.
    """

    slope: float | None = None
    tip_over_angle: float = DEFAULT_TIP_OVER
    slope_span: Span | None = None
    tip_over_span: Span | None = None


def read_design(document: Node, report: Report) -> DesignRequirements:
    """Reads the `design` section of a robot document.

    A missing or invalid requirement is replaced by the default requirement.
    """
    node = document.get("design")
    if node is None:
        return DesignRequirements()
    reader = ValueReader(report)

    def angle(key: str, default: float) -> float:
        entry = node.get(key)
        if entry is None:
            return default
        hint = None
        if isinstance(entry.value, int | float) and not isinstance(entry.value, bool):
            value, hint = float(entry.value), f"write `{entry.value:g} deg` if degrees are meant"
        else:
            value = reader.quantity(entry, "angle", default)
        if 0.0 <= value < math.pi / 2:
            return value
        report.add(
            "number-out-of-range",
            f"`{key}` is {math.degrees(value):.6g} deg; it must be from 0 to less than 90 deg",
            entry.span,
            hint=hint,
        )
        return default

    slope, tip_over = node.get("slope"), node.get("minimum_tip_over_angle")
    return DesignRequirements(
        angle("slope", 0.0) if slope is not None else None,
        angle("minimum_tip_over_angle", DEFAULT_TIP_OVER),
        slope.where if slope is not None else None,
        tip_over.where if tip_over is not None else None,
    )
