"""Tests of ``Wheel``."""

from __future__ import annotations

from dataclasses import replace

from tests.robots import FOUR_STEERED, make_robot


def test_radius_named_falls_back_to_the_ordinary_radius() -> None:
    wheel = make_robot(FOUR_STEERED).wheels[0]
    wheel = replace(wheel, radius=0.2, radii=(("floor", 0.2), ("rail", 0.09)))
    assert wheel.radius_named("rail") == 0.09
    assert wheel.radius_named("mud") == 0.2
    assert wheel.radius_named(None) == 0.2
