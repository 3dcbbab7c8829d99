"""The contact point of a wheel on level ground."""

from __future__ import annotations

import math

from thorvaldc.model.robot import Wheel


def contact_point(wheel: Wheel) -> tuple[float, float]:
    """Return the contact point (x, y in m) of a wheel in ``base_link``, with all joints at 0."""
    c, s = math.cos(wheel.heading), math.sin(wheel.heading)
    return (
        wheel.x + c * wheel.trail - s * wheel.lateral_offset,
        wheel.y + s * wheel.trail + c * wheel.lateral_offset,
    )
