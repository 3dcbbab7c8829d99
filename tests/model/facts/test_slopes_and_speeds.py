"""Slopes by a closed form, and the directions and turns that the base calculator agrees with."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.examples import ROBOTS, example_robot
from tests.robots import make_robot
from thorvaldc.model import Robot
from thorvaldc.model.facts.driving import SlopeLimits
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.reachable_twists import ReachableTwists
from thorvaldc.runtime.se2 import Twist

SQUARE = [(0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4)]


def limits_of(robot: Robot) -> tuple[SlopeLimits, SlopeLimits]:
    slopes = robot_facts(robot).slopes
    assert slopes is not None
    return slopes.forwards, slopes.backwards


def with_wheels(robot: Robot, friction: float, rolling: float) -> Robot:
    wheels = (replace(w, friction=friction, rolling_resistance=rolling) for w in robot.wheels)
    return replace(robot, wheels=tuple(wheels))


def test_the_grip_of_four_driven_wheels() -> None:
    """All wheels are driven: tan(a) = mu - c, whatever the loads."""
    robot = with_wheels(make_robot([(x, y, "steered") for x, y in SQUARE]), 0.5, 0.03)
    for limits in limits_of(robot):
        assert limits.grip == pytest.approx(math.atan(0.5 - 0.03))
        assert (limits.steepest, limits.reason) == (limits.grip, "grip")


def test_no_slope_beyond_80_degrees_is_stated() -> None:
    for angle, stated in ((79.9, True), (80.1, False)):
        friction = math.tan(math.radians(angle))
        robot = with_wheels(make_robot([(x, y, "steered") for x, y in SQUARE]), friction, 0.0)
        for limits in limits_of(robot):
            assert (limits.grip is not None) is stated


def test_the_grip_of_two_driven_wheels_in_front() -> None:
    """With the lever arms l to the rear axle, L between the axles, and the height h:

    uphill forwards  N = W (l cos(a) - h sin(a)) / L,  mu N = W sin(a)
                     tan(a) = mu l / (L + mu h);  uphill backwards  tan(a) = mu l / (L - mu h).
    """
    kinds = ("fixed", "fixed", "passive", "passive")
    robot = make_robot([(x, y, kind) for (x, y), kind in zip(SQUARE, kinds, strict=True)])
    robot = with_wheels(robot, 0.6, 0.0)
    x, _, h = robot.inertial.com
    lever, base, mu = x + 0.5, 1.0, 0.6
    forwards, backwards = limits_of(robot)
    assert forwards.grip == pytest.approx(math.atan(mu * lever / (base + mu * h)))
    assert backwards.grip == pytest.approx(math.atan(mu * lever / (base - mu * h)))


def test_the_torque_of_the_motors() -> None:
    """F = W sin(a) + c W cos(a)."""
    robot = with_wheels(make_robot([(x, y, "steered") for x, y in SQUARE]), 2.0, 0.05)
    motors = tuple(
        replace(motor, max_torque=20.0) if motor.role == "propulsion" else motor
        for motor in robot.actuators
    )
    robot = replace(robot, actuators=motors)
    for limits in limits_of(robot):
        assert limits.torque is not None
        force = 4 * 20.0 / robot.wheels[0].radius
        weight = robot.inertial.mass * GRAVITY
        needed = weight * (math.sin(limits.torque) + 0.05 * math.cos(limits.torque))
        assert needed == pytest.approx(force)
        assert limits.reason == "torque"


def test_a_robot_that_cannot_even_roll_on_level_ground() -> None:
    robot = with_wheels(make_robot([(x, y, "steered") for x, y in SQUARE]), 0.02, 0.05)
    assert [limits.steepest for limits in limits_of(robot)] == [0.0, 0.0]


@pytest.mark.parametrize("name", ROBOTS)
def test_top_speeds_are_reachable_for_the_base_calculator(name: str) -> None:
    robot = example_robot(name)
    driving = robot_facts(robot).driving
    geometry = BaseGeometry.from_robot(robot)
    calculator = ReachableTwists(geometry, FixedWheels(geometry.wheels))

    def is_reachable(*twist: float) -> bool:
        return tuple(calculator.feasible(Twist(*twist))) == pytest.approx(twist, abs=1e-6)

    assert driving.forwards == robot.driver.max_linear_velocity
    assert driving.sideways in (0.0, robot.driver.max_linear_velocity)
    assert is_reachable(0.0, 1.0, 0.0) is (driving.sideways > 0.0)
    turn = driving.turn
    assert turn is not None
    assert is_reachable(turn.y, -turn.x, 1.0)
    assert turn.yaw_rate <= robot.driver.max_angular_velocity
    assert turn.yaw_rate * turn.radius <= robot.driver.max_linear_velocity * (1.0 + 1e-9)
    if abs(turn.y) > 1e-3:  # the centre is as near as the steering allows
        assert not is_reachable(0.99 * turn.y, -turn.x, 1.0)
