"""Odometry of two driven wheels, whose axle need not be at ``base_link``."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.runtime.calculators.differential import Differential

SPEEDS = [(2.0, 2.0), (1.0, 3.0), (-2.0, 1.0)]


@pytest.mark.parametrize("speeds", SPEEDS)
def test_the_covariance_moves_with_the_axle(speeds: tuple[float, float]) -> None:
    """With the axle at x, the velocity across is vy = v - x wz, if v is that of the axle."""
    estimates = []
    for x in (0.0, -0.4):
        wheels = (wheel("l", x, 0.5, "fixed"), wheel("r", x, -0.3, "fixed"))
        calculator = Differential(BaseGeometry.from_wheels(wheels))
        states = JointStates(0.0, list(speeds), [0.0, 0.0], [0.0, 0.0])
        estimates.append(calculator.odometry(states))
    at_axle, behind = estimates
    move = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.4], [0.0, 0.0, 1.0]])
    assert np.array(behind.twist) == pytest.approx(move @ np.array(at_axle.twist))
    expected = move @ np.array(at_axle.covariance) @ move.T
    assert np.array(behind.covariance) == pytest.approx(expected)


@pytest.mark.parametrize("speeds", SPEEDS)
def test_odometry_turns_with_the_robot(speeds: tuple[float, float]) -> None:
    """Wheels that point in another direction give the turned twist with the turned covariance."""
    places = [(-0.4, 0.5), (-0.4, -0.3)]
    estimates = []
    for angle in (0.0, 0.7):
        c, s = math.cos(angle), math.sin(angle)
        wheels = [
            wheel(f"w{i}", c * x - s * y, s * x + c * y, "fixed", heading=angle)
            for i, (x, y) in enumerate(places)
        ]
        states = JointStates(0.0, list(speeds), [0.0, 0.0], [0.0, 0.0])
        estimates.append(Differential(BaseGeometry.from_wheels(wheels)).odometry(states))
    straight, turned = estimates
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert np.array(turned.twist) == pytest.approx(turn @ np.array(straight.twist))
    expected = turn @ np.array(straight.covariance) @ turn.T
    assert np.array(turned.covariance) == pytest.approx(expected, abs=1e-12)
