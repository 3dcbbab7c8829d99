"""Expectations of a scenario: bounds that belong to the range, and their texts."""

from __future__ import annotations

import math

import pytest

from tests.robots import SPAN
from thorvaldc.simulation.scenario_run import Check


@pytest.mark.parametrize(
    ("value", "minimum", "maximum", "passed"),
    [
        (1.0, None, None, True),
        (1.0, 1.0, 1.0, True),
        (0.999, 1.0, None, False),
        (1.001, None, 1.0, False),
        (1.5, 1.0, 2.0, True),
        (math.nan, None, None, False),
        (math.inf, 1.0, None, False),
    ],
)
def test_a_value_within_its_bounds_passes(
    value: float, minimum: float | None, maximum: float | None, passed: bool
) -> None:
    assert Check("robot", "path", value, minimum, maximum, SPAN).passed is passed


@pytest.mark.parametrize(
    ("metric", "minimum", "maximum", "bounds", "value"),
    [
        ("path", 1.0, 2.5, "at least 1 m and at most 2.5 m", "1.5 m"),
        ("yaw_error", None, math.radians(20.0), "at most 20 deg", "85.94 deg"),
        ("collisions", None, 0.0, "at most 0", "1.5"),
        ("slip", 0.125, None, "at least 0.125 m/s", "1.5 m/s"),
    ],
)
def test_texts_have_units(
    metric: str, minimum: float | None, maximum: float | None, bounds: str, value: str
) -> None:
    check = Check("robot", metric, 1.5, minimum, maximum, SPAN)
    assert (check.bounds, check.value_text) == (bounds, value)
