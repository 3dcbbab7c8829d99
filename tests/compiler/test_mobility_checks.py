"""Motions that the wheels of a robot allow and control."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.robots import make_robot
from thorvaldc.compiler.robot_checks import check_robot
from thorvaldc.compiler.robot_settings.robot_sections import DesignRequirements
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.statics.mobility import feasible_twists

SQUARE = [(0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)]


def codes(robot: Robot) -> list[str]:
    report = Report()
    check_robot(robot, DesignRequirements(), report)
    return [d.code.name for d in report]


def square_base(*kinds: str) -> Robot:
    """Returns a box on four wheels in a square: front left, front right, rear left, rear right."""
    return make_robot([(x, y, kind) for (x, y), kind in zip(SQUARE, kinds, strict=True)])


@pytest.mark.parametrize(
    "kinds",
    [
        ("steered",) * 4,
        ("steered", "steered", "fixed", "fixed"),
        ("swivel", "swivel", "fixed", "fixed"),
        ("steered", "steered", "passive", "passive"),
        ("swivel", "steered", "passive", "passive"),
    ],
)
def test_controllable_bases(kinds: tuple[str, ...]) -> None:
    assert codes(square_base(*kinds)) == []


@pytest.mark.parametrize(
    ("kinds", "twists"),
    [
        (("steered",) * 4, 3),
        (("swivel",) * 4, 3),
        (("steered", "steered", "fixed", "fixed"), 2),
        (("fixed",) * 4, 1),
        (("swivel", "swivel", "swivel", "fixed"), 2),
    ],
)
def test_number_of_feasible_twists(kinds: tuple[str, ...], twists: int) -> None:
    assert feasible_twists(square_base(*kinds)) == twists


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [
        (("steered", "swivel", "swivel", "swivel"), ["twist-uncontrolled"]),
        (("passive", "passive", "swivel", "swivel"), ["no-drive"]),
        (("fixed",) * 4, ["skid-steering"]),
    ],
)
def test_uncontrollable_bases(kinds: tuple[str, ...], expected: list[str]) -> None:
    assert codes(square_base(*kinds)) == expected


def test_one_misaligned_wheel_blocks_motion() -> None:
    robot = square_base("fixed", "fixed", "fixed", "fixed")
    turned = replace(robot.wheels[0], heading=0.2)
    assert "no-free-motion" in codes(replace(robot, wheels=(turned, *robot.wheels[1:])))
    # All axles meet in one point: the robot can only turn on the spot.
    tangents = tuple(replace(w, heading=math.atan2(w.x, -w.y)) for w in robot.wheels)
    round_robot = replace(robot, wheels=tangents)
    assert feasible_twists(round_robot) == 1
    assert codes(round_robot) == []
