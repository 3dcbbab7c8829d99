"""Default manoeuvres of robots and fleets, and the twist at a time."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.examples import example_robot
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2, Twist
from thorvaldc.simulation.control_loop import (
    Segment,
    default_manoeuvre,
    fleet_manoeuvres,
    twist_at,
)

STEERED = make_robot(FOUR_STEERED)
FAST = replace(STEERED, driver=replace(STEERED.driver, max_linear_velocity=2.0))
SLOW = replace(
    STEERED, driver=replace(STEERED.driver, max_linear_velocity=0.5, max_angular_velocity=0.25)
)


def test_the_twist_changes_at_the_start_of_a_segment() -> None:
    first, second = Twist(1.0, 0.0, 0.0), Twist(0.0, 1.0, 0.0)
    manoeuvre = [Segment(1.0, first), Segment(2.0, second)]
    times = (0.0, 0.999, 1.0, 1.999, 2.0, 99.0)
    twists = [twist_at(manoeuvre, time) for time in times]
    assert twists == [ZERO_TWIST, ZERO_TWIST, first, first, second, second]
    assert twist_at(manoeuvre, 1.0 - 1e-10) == first, "a tick that is rounded down"


@pytest.mark.parametrize(("robot", "v", "w"), [(FAST, 1.0, 0.5), (SLOW, 0.4, 0.2)])
def test_parts_of_the_default_manoeuvre(robot: Robot, v: float, w: float) -> None:
    segments, duration = default_manoeuvre(robot)
    assert [segment.start for segment in segments] == [0.0, 4.0, 8.0, 11.0, 14.0]
    assert duration == 16.0
    expected = [(v, 0.0, 0.0), (v, 0.0, w), (0.0, 0.7 * v, 0.0), (0.0, 0.0, -w), (0.0, 0.0, 0.0)]
    assert [tuple(s.twist) for s in segments] == [pytest.approx(twist) for twist in expected]


def test_a_robot_that_cannot_drive_sideways_leaves_that_part_out() -> None:
    segments, duration = default_manoeuvre(example_robot("2wd0ws_greenhouse"))
    assert [segment.start for segment in segments] == [0.0, 4.0, 8.0, 11.0]
    assert duration == 13.0
    assert all(segment.twist.vy == 0.0 for segment in segments)


def moved(x: float, y: float) -> list[tuple[str, Robot, Pose2]]:
    return [("a", FAST, Pose2(0.0, 0.0, 0.0)), ("b", SLOW, Pose2(x, y, 0.0))]


@pytest.mark.parametrize(
    ("x", "y", "starts", "speed"),
    [
        (0.0, 20.0, [0.0, 4.0, 8.0, 11.0, 14.0], 0.4),
        # One behind the other: both drive the same path.
        (-3.0, 0.0, [0.0, 4.0, 8.0, 11.0, 14.0], 0.4),
    ],
)
def test_a_fleet_drives_the_parts_of_its_slowest_robot(
    x: float, y: float, starts: list[float], speed: float
) -> None:
    manoeuvres, duration = fleet_manoeuvres(moved(x, y))
    assert duration == starts[-1] + 2.0
    for segments in manoeuvres.values():
        assert [segment.start for segment in segments] == starts
        assert segments[0].twist == Twist(speed, 0.0, 0.0)
        assert segments[-1].twist == ZERO_TWIST


def test_robots_that_meet_get_a_shorter_manoeuvre() -> None:
    """They face each other 3 m apart, so that both may only turn."""
    face_to_face = [("a", FAST, Pose2(0.0, 0.0, 0.0)), ("b", FAST, Pose2(3.0, 0.0, math.pi))]
    manoeuvres, duration = fleet_manoeuvres(face_to_face)
    assert duration == 5.0
    for segments in manoeuvres.values():
        assert [tuple(s.twist) for s in segments] == [(0.0, 0.0, -0.5), (0.0, 0.0, 0.0)]
        assert [s.start for s in segments] == [0.0, 3.0]
    assert fleet_manoeuvres([]) == ({}, 2.0)


def test_robots_that_approach_slowly_enough_drive_forward() -> None:
    """Forward at 1 m/s for 4 s needs 8 m between the robots; at 0.4 m/s it needs 3.2 m."""
    speeds = {}
    for distance in (5.0, 9.0, 11.0):
        robots = [("a", FAST, Pose2(0.0, 0.0, 0.0)), ("b", FAST, Pose2(distance, 0.0, math.pi))]
        manoeuvres, _ = fleet_manoeuvres(robots)
        speeds[distance] = manoeuvres["a"][0].twist.vx
    assert speeds == {5.0: 0.4, 9.0: 0.4, 11.0: 1.0}
