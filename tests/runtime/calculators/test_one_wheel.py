"""Odometry of one driven and steered wheel, whose fixed axle may point anywhere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.differential import OneWheel
from thorvaldc.runtime.se2 import Twist

STATES = [
    JointStates(0.0, [3.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.0, 0.0]),
    JointStates(0.0, [-2.0, 0.0, 0.0], [-0.8, 0.0, 0.0], [0.5, 0.0, 0.0]),
]


def wheels(angle: float = 0.0, x: float = -0.6) -> list[WheelGeometry]:
    """A robot whose axle is at ``x``, turned by ``angle`` about ``base_link``."""
    places = [(0.6, 0.1, "steered"), (x, 0.4, "passive"), (x, -0.5, "passive")]
    c, s = math.cos(angle), math.sin(angle)
    return [
        wheel(
            f"w{i}",
            c * x - s * y,
            s * x + c * y,
            kind,
            heading=angle,
            **({"trail": -0.06, "lateral": 0.04, "sign": -1.0} if kind == "steered" else {}),
        )
        for i, (x, y, kind) in enumerate(places)
    ]


@pytest.mark.parametrize("states", STATES)
def test_odometry_turns_with_the_robot(states: JointStates) -> None:
    straight, turned = (
        OneWheel(BaseGeometry.from_wheels(wheels(angle))).odometry(states) for angle in (0.0, 0.7)
    )
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert np.array(turned.twist) == pytest.approx(turn @ np.array(straight.twist))
    expected = turn @ np.array(straight.covariance) @ turn.T
    assert np.array(turned.covariance) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_commands_and_odometry_agree(angle: float) -> None:
    """The wheel that the command has steered drives the robot with the commanded twist."""
    calculator = OneWheel(BaseGeometry.from_wheels(wheels(angle)))
    c, s = math.cos(angle), math.sin(angle)
    for v, wz in ((0.5, 0.0), (0.4, 0.3), (-0.4, 0.3), (-0.3, -0.2)):
        across = 0.6 * wz  # the axle is 0.6 m behind base_link, and does not slip sideways
        twist = Twist(c * v - s * across, s * v + c * across, wz)
        calculator.reset()
        command = calculator.command(twist)
        assert command.target == pytest.approx(twist)
        joints = command.joints
        states = JointStates(0.0, list(joints.speeds), list(joints.angles), [0.0] * 3)
        assert calculator.odometry(states).twist == pytest.approx(twist)


def test_the_motion_of_a_command_is_that_of_its_joints_while_the_wheel_turns() -> None:
    """The contact point is ahead of and beside the steering axis, and moves as the axis turns."""
    first, *others = wheels()
    slow = replace(first, max_rate=1.0, max_rate_change=20.0)
    calculator = OneWheel(BaseGeometry.from_wheels([slow, *others]))
    states = JointStates(0.0, [0.0] * 3, [0.0] * 3, [0.0] * 3)
    calculator.reset(states)
    turned = 0
    for _ in range(60):
        command = calculator.command(Twist(0.1, 0.18, 0.3), states, 0.02)
        speeds, angles = list(command.joints.speeds), list(command.joints.angles)
        rate = (angles[0] - states.angles[0]) / 0.02
        turned += abs(rate) > 0.5
        motion = JointStates(0.0, speeds, list(states.angles), [rate, 0.0, 0.0])
        assert command.twist == pytest.approx(calculator.odometry(motion).twist, abs=1e-9)
        states = JointStates(0.0, speeds, angles, [rate, 0.0, 0.0])
    assert turned > 10
