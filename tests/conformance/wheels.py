"""Wheel geometries for tests."""

from __future__ import annotations

import math

from thorvaldc.runtime.calculators import WheelGeometry


def wheel(
    name: str,
    x: float,
    y: float,
    kind: str,
    *,
    heading: float = 0.0,
    sign: float = 1.0,
    trail: float = 0.0,
    lateral: float = 0.0,
    radius: float = 0.2,
    limits: tuple[float | None, float | None] = (-math.pi, math.pi),
) -> WheelGeometry:
    """A wheel of a kind: steered, turned (steered, not driven), fixed, passive or swivel."""
    driven = kind in ("steered", "fixed")
    turned = kind in ("steered", "turned")
    return WheelGeometry(
        name=name,
        x=x,
        y=y,
        heading=heading,
        sign=sign,
        trail=trail,
        lateral=lateral,
        radius=radius,
        driven=driven,
        steered=turned,
        swivel=kind == "swivel",
        encoder=driven,
        max_speed=7.5 if driven else math.inf,
        max_acceleration=7.5 if driven else math.inf,
        lower=limits[0] if turned else None,
        upper=limits[1] if turned else None,
        max_rate=4.0 if turned else math.inf,
        max_rate_change=20.0 if turned else math.inf,
    )
