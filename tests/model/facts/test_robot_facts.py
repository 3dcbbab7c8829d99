"""Facts about robots: simple robots by hand, and every example."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from dataclasses import replace

import pytest

from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.robots import make_robot
from thorvaldc.model.facts.fact_tables import fact_tables
from thorvaldc.model.facts.robot_facts import fact_sections, facts_document, robot_facts
from thorvaldc.model.spatial import GRAVITY

SQUARE = [(0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4)]
STEERED = [(x, y, "steered") for x, y in SQUARE]


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_facts_of_an_example_agree_with_each_other(name: str) -> None:
    robot = example_robot(name)
    facts = robot_facts(robot)
    assert facts.mass == pytest.approx(sum(module.mass or 0.0 for module in facts.modules))
    loads = [wheel.load for wheel in facts.wheels]
    assert sum(loads) == pytest.approx(facts.mass * GRAVITY)
    assert sum(wheel.share for wheel in facts.wheels) == pytest.approx(1.0)
    for axis in (0, 1):  # the centre of the loads is below the centre of mass
        moment = sum(wheel.load * (wheel.x, wheel.y)[axis] for wheel in facts.wheels)
        assert moment / sum(loads) == pytest.approx(facts.center_of_mass[axis], abs=1e-9)
    size = facts.size
    assert not size.meshes_left_out
    assert size.ground_clearance is not None
    assert 0.0 < size.ground_clearance < size.height
    assert size.wheelbase is not None
    assert size.wheelbase < size.length
    assert size.track is not None
    assert size.track < size.width
    assert facts.stability.stands
    assert facts.stability.least is not None
    angles = [tip.angle for tip in facts.stability.polar]
    assert facts.stability.least.angle <= min(angles) + 1e-12
    assert min(angles) < facts.stability.least.angle + math.radians(1.0)
    json.dumps(facts_document(facts), allow_nan=False)


def test_size_and_tip_over_of_a_box_on_four_wheels() -> None:
    robot = make_robot(STEERED)
    facts = robot_facts(robot)
    assert facts.size.wheelbase == pytest.approx(1.0)
    assert facts.size.track == pytest.approx(0.8)
    assert facts.size.length == pytest.approx(1.4)  # wheels of 0.2 m
    x, y, z = facts.center_of_mass
    angles = dict(facts.stability.angles)
    assert angles["front"] == pytest.approx(math.atan((0.5 - x) / z))
    assert angles["rear"] == pytest.approx(math.atan((0.5 + x) / z))
    assert angles["left"] == pytest.approx(math.atan((0.4 - y) / z))
    assert angles["right"] == pytest.approx(math.atan((0.4 + y) / z))
    least = facts.stability.least
    assert least is not None
    assert least.angle == pytest.approx(min(angles.values()))


def test_a_robot_with_steered_wheels_drives_in_every_direction() -> None:
    robot = make_robot(STEERED)
    driving = robot_facts(robot).driving
    assert driving.forwards == driving.sideways == robot.driver.max_linear_velocity
    assert driving.turn is not None
    assert driving.turn.radius == 0.0
    assert driving.turn.wheel_circle == pytest.approx(2.0 * math.hypot(0.5, 0.4))


def test_fixed_wheels_turn_by_skidding_and_not_sideways() -> None:
    driving = robot_facts(make_robot([(x, y, "fixed") for x, y in SQUARE])).driving
    assert driving.forwards > 0.0
    assert driving.sideways == 0.0
    assert driving.turn is not None
    assert driving.turn.skids


@pytest.mark.parametrize(
    ("angular", "linear"), [(0.01, 9.0), (9.0, 0.01), (1e3, 1e3)], ids=["yaw", "base", "motors"]
)
def test_a_differential_drive_turns_about_its_axle(angular: float, linear: float) -> None:
    robot = make_robot([(-0.3, 0.4, "fixed"), (-0.3, -0.4, "fixed"), (0.5, 0.0, "swivel")])
    driver = replace(robot.driver, max_angular_velocity=angular, max_linear_velocity=linear)
    robot = replace(robot, driver=driver)
    turn = robot_facts(robot).driving.turn
    assert turn is not None
    assert not turn.skids
    assert (turn.x, turn.y) == pytest.approx((-0.3, 0.0))
    motor = robot.actuators[0]
    limits = (
        robot.driver.max_angular_velocity,
        robot.driver.max_linear_velocity / 0.3,
        motor.max_velocity * 0.2 / 0.4,
    )
    assert turn.yaw_rate == pytest.approx(min(limits))


def test_the_turning_circle_of_a_car() -> None:
    """Ackermann: the inner wheel is at its limit, the centre is on the rear axle."""
    turn = robot_facts(example_robot("car")).driving.turn
    facts = robot_facts(example_robot("car"))
    assert turn is not None
    assert facts.size.wheelbase
    assert facts.size.track
    assert abs(turn.y) == pytest.approx(
        facts.size.wheelbase / math.tan(math.radians(35.0)) + facts.size.track / 2
    )


def test_a_robot_whose_center_of_mass_is_outside_the_wheels() -> None:
    robot = make_robot([(0.5, 0.4, "steered"), (0.5, -0.4, "steered"), (0.2, 0.0, "swivel")])
    stability = robot_facts(robot).stability
    assert not stability.stands
    assert stability.least is None
    assert not stability.polar
    assert stability.margin is not None
    assert stability.margin < 0.0
    assert set(dict(stability.angles).values()) == {0.0}


def test_a_robot_on_a_line_of_wheels() -> None:
    facts = robot_facts(make_robot([(0.5, 0.0, "steered"), (-0.5, 0.0, "steered")]))
    assert facts.stability.margin is None
    assert not facts.stability.stands
    assert facts.size.track is None


def test_a_robot_on_casters_only() -> None:
    facts = robot_facts(make_robot([(x, y, "swivel") for x, y in SQUARE]))
    assert facts.driving.forwards == 0.0
    assert facts.driving.turn is None
    assert facts.stability.stands


def test_load_on_the_soil() -> None:
    """The nominal ground pressure is the load over radius times width."""
    robot = make_robot(STEERED)
    first, *others = robot.wheels
    robot = replace(robot, wheels=(replace(first, load=800.0, radius=0.4, width=0.1), *others))
    soil = robot_facts(robot).soil
    assert soil is not None
    assert soil.wheel_load == 800.0
    assert soil.pressure == pytest.approx(
        max(20_000.0, *(wheel.load / (wheel.radius * wheel.width) for wheel in others))
    )
    narrow = robot_facts(replace(robot, wheels=(replace(first, width=0.0), *others))).soil
    assert narrow is not None
    assert narrow.pressure is None
    assert robot_facts(replace(robot, wheels=())).soil is None


def test_the_motors_limit_the_turn_of_steered_wheels() -> None:
    places = [(0.5, 0.4), (0.5, -0.4), (-0.6, 0.4), (-0.6, -0.4)]
    robot = make_robot([(x, y, "steered") for x, y in places])
    driver = replace(robot.driver, max_angular_velocity=1e3, max_linear_velocity=1e3)
    turn = robot_facts(replace(robot, driver=driver)).driving.turn
    assert turn is not None
    lever = max(math.dist((turn.x, turn.y), place) for place in places)
    speed = min(a.max_velocity for a in robot.actuators if a.role == "propulsion")
    assert turn.yaw_rate == pytest.approx(speed * 0.2 / lever)


def test_sections_of_the_facts_are_parts_of_all_facts() -> None:
    robot = example_robot("4wd4ws_wide")
    facts = robot_facts(robot)
    names = [field.name for field in dataclasses.fields(facts)]
    assert fact_sections(robot, names) == {n: getattr(facts, n) for n in names}
    assert list(fact_sections(robot, ["mass"])) == ["mass"]


@pytest.mark.parametrize("name", ["4wd4ws_wide", "9wd9ws"])
def test_columns_of_numbers_are_marked_in_the_tables(name: str) -> None:
    number = re.compile(r"(over )?[-+]?\d[\d.]*(:1)?( ?(%|deg|[A-Z]{3}|d))?|-")
    for table in fact_tables(robot_facts(example_robot(name))):
        for column, cells in enumerate(zip(*table.rows, strict=True)):
            has_numbers = all(map(number.fullmatch, cells)) and set(cells) != {"-"}
            assert (column in table.numeric) == has_numbers, (table.key, column, cells[:3])
