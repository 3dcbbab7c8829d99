"""What a robot's file asks of the robot as a whole."""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.compiler.library import Library
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span

DEFAULT_TIP_OVER = math.radians(15)


class Design(NamedTuple):
    """What the file asks: ``slope`` to climb, ``tip_over_angle`` to keep, rad; and where."""

    slope: float | None = None
    tip_over_angle: float = DEFAULT_TIP_OVER
    slope_place: Span | None = None
    tip_over_place: Span | None = None


def read_design(document: Node, library: Library, report: Report) -> Design:
    """The `design` of a robot's document."""
    node = document.get("design")
    if node is None:
        return Design()
    scope = Scope(None, {}, library, report, None)

    def angle(key: str, default: float) -> float:
        found = node.get(key)
        given = found.value if found is not None else None
        hint = None
        if isinstance(given, int | float) and not isinstance(given, bool):
            value, hint = float(given), f"write `{given:g} deg` if degrees are meant"
        else:
            value = scope.quantity(found, "angle", default)
        if found is None or 0.0 <= value < math.pi / 2:
            return value
        report.add(
            "number-out-of-range",
            f"`{key}` is {math.degrees(value):.6g} deg; it must be from 0 to less than 90 deg",
            found.span,
            hint=hint,
        )
        return default

    slope, tip_over = node.get("slope"), node.get("minimum_tip_over_angle")
    return Design(
        angle("slope", 0.0) if slope is not None else None,
        angle("minimum_tip_over_angle", Design().tip_over_angle),
        slope.where if slope is not None else None,
        tip_over.where if tip_over is not None else None,
    )
