"""Slopes on which a robot stands without power, by closed forms, and how a wheel rolls out."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.examples import ROBOTS, example_robot
from tests.robots import make_robot
from thorvaldc.model import Brake, Robot
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.slope import (
    coasting_deceleration,
    holds_without_torque,
    roll_out,
    standing_slopes,
)
from thorvaldc.model.statics.tip_over import support_of

SQUARE = [(0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4)]


def robot_of(
    kinds: str = "steered steered steered steered",
    *,
    rolling: float = 0.0,
    friction: float = 0.8,
    back_driving: float = 0.0,
    brake: Brake | None = None,
) -> Robot:
    wheels = [(x, y, kind) for (x, y), kind in zip(SQUARE, kinds.split(), strict=True)]
    robot = make_robot(wheels)
    return replace(
        robot,
        wheels=tuple(
            replace(w, rolling_resistance=rolling, friction=friction) for w in robot.wheels
        ),
        actuators=tuple(
            replace(a, back_driving_torque=back_driving, brake=brake) for a in robot.actuators
        ),
    )


def motors_off(robot: Robot) -> float:
    slopes = standing_slopes(robot)
    assert slopes is not None
    return slopes.motors_off


def test_rolling_resistance_alone() -> None:
    """c W cos(a) = W sin(a)."""
    assert motors_off(robot_of(rolling=0.03)) == pytest.approx(math.atan(0.03))


def test_without_friction_every_slope_starts_a_motion() -> None:
    robot = robot_of()
    assert motors_off(robot) == 0.0
    assert not holds_without_torque(replace(robot, design_slope=0.001))
    assert holds_without_torque(replace(robot, design_slope=0.0))


def test_the_back_driving_torque_of_the_driven_wheels() -> None:
    """n T / r = W sin(a)."""
    robot = robot_of("fixed fixed passive passive", back_driving=4.0)
    weight = robot.inertial.mass * GRAVITY
    assert motors_off(robot) == pytest.approx(math.asin(2 * 4.0 / 0.2 / weight))
    steered = replace(robot, actuators=robot.actuators[:1])
    assert motors_off(steered) == pytest.approx(math.asin(4.0 / 0.2 / weight))


def test_the_friction_of_an_axle_holds_too() -> None:
    robot = robot_of("passive passive passive passive")
    joints = tuple(replace(j, friction=1.5) if "axle" in j.name else j for j in robot.joints)
    robot = replace(robot, joints=joints)
    weight = robot.inertial.mass * GRAVITY
    assert motors_off(robot) == pytest.approx(math.asin(4 * 1.5 / 0.2 / weight))


def test_a_brake_holds_until_the_tyres_slip() -> None:
    weak, strong = (robot_of(friction=0.3, brake=Brake(t, 0.03)) for t in (5.0, 500.0))
    weight = weak.inertial.mass * GRAVITY
    slopes = standing_slopes(weak)
    assert slopes is not None
    assert slopes.braked == pytest.approx(math.asin(4 * 5.0 / 0.2 / weight))
    assert slopes.motors_off == 0.0
    assert slopes.without_power == slopes.braked
    slopes = standing_slopes(strong)
    assert slopes is not None
    assert slopes.braked == pytest.approx(math.atan(0.3))


def test_a_robot_does_not_stand_beyond_its_tip_over_angle() -> None:
    robot = robot_of(friction=3.0, brake=Brake(5000.0, 0.03))
    slopes = standing_slopes(robot)
    tips = min(support_of(robot).tip_over_angle(direction) for direction in (0.0, math.pi))
    assert slopes is not None
    assert slopes.braked == tips < math.atan(3.0)


def test_brakes_on_one_axle_hold_less_where_it_is_unloaded() -> None:
    """Facing uphill or downhill, the worse of the two counts: the loads move downhill."""
    robot = robot_of("fixed fixed passive passive", friction=0.4, brake=Brake(5000.0, 0.03))
    x, _, h = robot.inertial.com
    lever, base, mu = x + 0.5, 1.0, 0.4
    slopes = standing_slopes(robot)
    assert slopes is not None
    assert slopes.braked == pytest.approx(math.atan(mu * lever / (base + mu * h)))


def test_torque_is_needed_on_the_design_slope_exactly_beyond_the_limit() -> None:
    robot = robot_of(rolling=0.05)
    limit = math.atan(0.05)
    assert holds_without_torque(replace(robot, design_slope=0.99 * limit))
    assert not holds_without_torque(replace(robot, design_slope=1.01 * limit))
    braked = robot_of(rolling=0.05, brake=Brake(60.0, 0.03))
    assert holds_without_torque(replace(braked, design_slope=1.01 * limit))


def test_nothing_holds_on_unknown_ground_or_without_a_stand() -> None:
    assert not holds_without_torque(robot_of(rolling=0.05))
    two = make_robot([(0.0, 0.4, "fixed"), (0.0, -0.4, "fixed")])
    assert standing_slopes(two) is None
    assert not holds_without_torque(replace(two, design_slope=0.0))


def test_the_way_on_which_a_robot_rolls_out_without_power() -> None:
    """c g decelerates a wheel from its top speed; a brake acts after its closing time."""
    robot = robot_of(rolling=0.05)
    top = robot.actuators[0].max_velocity * robot.wheels[0].radius
    speed, seconds, distance = roll_out(robot)
    assert speed == pytest.approx(top)
    assert seconds == pytest.approx(top / (0.05 * GRAVITY))
    assert distance == pytest.approx(top**2 / (2 * 0.05 * GRAVITY))
    _, braked, shorter = roll_out(robot_of(friction=0.4, brake=Brake(5000.0, 0.1)))
    assert braked == pytest.approx(0.1 + top / (0.4 * GRAVITY))
    assert shorter == pytest.approx(0.1 * top + top**2 / (2 * 0.4 * GRAVITY))
    assert math.isinf(roll_out(robot_of()).distance)


@pytest.mark.parametrize("name", ROBOTS)
def test_examples_roll_out_within_the_bounds_of_their_numbers(name: str) -> None:
    robot = example_robot(name)
    for wheel in robot.wheels:
        motor = robot.actuator_of(wheel.spin_joint)
        if motor is None:
            continue
        axle = robot.joint(wheel.spin_joint)
        force = coasting_deceleration(wheel, axle, motor) * wheel.load / GRAVITY
        expected = wheel.rolling_resistance * wheel.load + motor.back_driving_torque / wheel.radius
        assert force == pytest.approx(expected)
        braked = replace(motor, brake=Brake(1e4, 0.0))
        assert coasting_deceleration(wheel, axle, braked) < GRAVITY * wheel.friction
        sliding = coasting_deceleration(wheel, axle, braked, braked=True)
        assert sliding == pytest.approx(GRAVITY * wheel.friction)
