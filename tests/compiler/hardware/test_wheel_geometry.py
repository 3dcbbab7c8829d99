"""Lowest point of a wheel, also under camber."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thorvaldc.compiler.hardware.wheel_geometry import lowest_point


@settings(deadline=None, max_examples=100)
@given(
    st.floats(-math.pi, math.pi),
    st.floats(-1.2, 1.2),
    st.floats(0.05, 1.0),
)
def test_lowest_point_is_on_the_middle_circle(yaw: float, camber: float, radius: float) -> None:
    axis = (
        -math.sin(yaw) * math.cos(camber),
        math.cos(yaw) * math.cos(camber),
        math.sin(camber),
    )
    lowest = np.array(lowest_point((1.0, 2.0, 3.0), axis, radius)) - [1.0, 2.0, 3.0]
    assert np.linalg.norm(lowest) == pytest.approx(radius)
    assert lowest @ np.array(axis) == pytest.approx(0.0, abs=1e-9)
    # No other point of the circle is lower.
    across = np.cross(axis, lowest)
    for angle in np.linspace(0, 2 * math.pi, 60):
        point_of_circle = math.cos(angle) * lowest + math.sin(angle) * across
        assert point_of_circle[2] >= lowest[2] - 1e-9
