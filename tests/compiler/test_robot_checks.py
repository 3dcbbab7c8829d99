"""Checks of a complete robot, on valid robots and at their limits."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.examples import FOLDER, ROBOTS
from tests.robots import FOUR_STEERED, make_robot
from tests.workshop import CART, Workshop
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.robot_checks import check_robot
from thorvaldc.compiler.robot_settings.robot_sections import DesignRequirements
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot

SQUARE = [(0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)]


def codes(robot: Robot, design: DesignRequirements | None = None) -> list[str]:
    report = Report()
    check_robot(robot, design or DesignRequirements(), report)
    return [d.code.name for d in report]


def square_base(*kinds: str) -> Robot:
    """Returns a box on four wheels in a square: front left, front right, rear left, rear right."""
    return make_robot([(x, y, kind) for (x, y), kind in zip(SQUARE, kinds, strict=True)])


def with_mass_at(robot: Robot, x: float, y: float, z: float) -> Robot:
    return replace(robot, inertial=replace(robot.inertial, com=(x, y, z)))


# -- valid robots -----------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_examples_have_no_diagnostics(name: str) -> None:
    compilation = compile_file(FOLDER / name / "robot.yaml")
    assert [
        (d.code.name, d.message) for d in compilation.report if d.severity.value != "note"
    ] == []


# -- balance ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "y", "z", "margin"),
    [(0.0, 0.0, 0.4, 0.5), (0.3, 0.0, 0.4, 0.2), (0.0, -0.45, 1.0, 0.05), (0.2, 0.3, 0.5, 0.2)],
)
def test_the_tip_over_angle_is_that_of_the_nearest_edge(
    x: float, y: float, z: float, margin: float
) -> None:
    robot = with_mass_at(make_robot(FOUR_STEERED), x, y, z)
    wheels = tuple(replace(w, x=px, y=py) for w, (px, py) in zip(robot.wheels, SQUARE, strict=True))
    robot = replace(robot, wheels=wheels)
    angle = math.atan2(margin, z)
    assert "tip-over" not in codes(robot, DesignRequirements(tip_over_angle=angle - 1e-6))
    assert "tip-over" in codes(robot, DesignRequirements(tip_over_angle=angle + 1e-6))


def test_inner_wheel_does_not_change_the_hull() -> None:
    four = make_robot(FOUR_STEERED)
    five = make_robot([*FOUR_STEERED, (0.0, 0.0, "steered")])
    for robot in (four, five):
        robot = with_mass_at(robot, 0.0, 0.0, 0.4)
        angle = math.atan2(0.45, 0.4)
        assert "tip-over" not in codes(robot, DesignRequirements(tip_over_angle=angle - 1e-6))
        assert "tip-over" in codes(robot, DesignRequirements(tip_over_angle=angle + 1e-6))


@pytest.mark.parametrize(("x", "stands"), [(0.4999, True), (0.5001, False), (-0.6, False)])
def test_robot_is_stable_while_its_centre_of_mass_is_inside_the_hull(
    x: float, stands: bool
) -> None:
    codes_of_robot = codes(
        with_mass_at(square_base("steered", "steered", "steered", "steered"), x, 0.0, 0.4)
    )
    assert ("unstable" not in codes_of_robot) is stands


@pytest.mark.parametrize("count", [1, 2, 3])
def test_wheels_on_a_line_are_unstable(count: int) -> None:
    robot = make_robot([(0.0, y, "steered") for y in (0.0, 0.5, -0.5)[:count]])
    assert "unstable" in codes(robot)


# -- overlap ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dx", "dy", "overlap"),
    [
        (0.0, 0.16, False),
        (0.0, 0.159, True),
        (0.4, 0.0, False),
        (0.399, 0.0, True),
        (0.3, 0.159, True),
        (0.3, 0.2, False),
    ],
)
def test_wheels_are_rectangles_from_above(dx: float, dy: float, overlap: bool) -> None:
    extra = (0.5 + dx, 0.5 + dy, "fixed")
    wheels = [*((x, y, "fixed") for x, y in SQUARE), extra]
    for order in (wheels, wheels[::-1]):
        assert ("wheels-overlap" in codes(make_robot(order))) is overlap


def test_overlap_check_of_many_wheels() -> None:
    wheels = [(float(i), float(j), "steered") for i in range(-5, 6) for j in range(-5, 6)]
    assert "wheels-overlap" not in codes(make_robot(wheels))
    assert "wheels-overlap" in codes(make_robot([*wheels, (3.1, 3.1, "steered")]))


# -- slopes -----------------------------------------------------------------------------


@pytest.mark.parametrize("driven", [1, 2, 4])
def test_the_slope_that_motors_can_climb(workshop: Workshop, driven: int) -> None:
    cart = CART
    for name in ("rr", "rl", "fr")[: 4 - driven]:
        cart = cart.replace(
            f"{name}: {{type: t/leg,", f"{name}: {{type: t/leg, params: {{driven: false}},"
        )
    # Of 132 kg: torque 50 N m on 0.2 m each, rolling resistance 0.01.
    weight, push = 132 * 9.81, driven * 50 / 0.2
    limit = math.degrees(math.asin(push / weight / math.hypot(1, 0.01)) - math.atan(0.01))
    # The axles are 1 m apart; the wheels (5 kg each) have their centres at 0.2 m, the rest is at
    # 0.6 m. On the slope a, a front wheel carries the share 1/4 - height tan(a) / 2 of W cos(a).
    height = (112 * 0.6 + 20 * 0.2) / 132 if driven < 4 else 0.0
    grip = math.degrees(math.atan((0.8 * driven / 4 - 0.01) / (1 + 0.8 * driven * height / 2)))
    limit = min(limit, grip)
    for slope, steep in ((limit - 0.01, False), (limit + 0.01, True)):
        diagnostics = workshop.diagnostics(cart, f"design: {{slope: {slope:.6f} deg}}\n")
        assert ("slope-too-steep" in [d.code.name for d in diagnostics]) is steep


def test_no_slope_is_required_by_default(workshop: Workshop) -> None:
    diagnostics = workshop.diagnostics(CART.replace("t/leg,", "t/leg, params: {torque: 0.01},"))
    assert "slope-too-steep" not in [d.code.name for d in diagnostics]


# -- inertia ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("inertia", "possible"),
    [
        ((1, 1, 2, 0, 0, 0), True),
        ((1, 1, 2.001, 0, 0, 0), False),
        ((1, 1, 1, 0.49, 0, 0), True),
        ((1, 1, 1, 0, 0.51, 0), False),
        ((1, 1, 0, 0, 0, 0), False),
        ((-1, -1, -1, 0, 0, 0), False),
    ],
)
def test_triangle_inequality_of_principal_moments(
    inertia: tuple[float, ...], possible: bool
) -> None:
    robot = make_robot(FOUR_STEERED)
    body = robot.links[1]
    assert body.inertial is not None
    odd = replace(body, inertial=replace(body.inertial, inertia=tuple(map(float, inertia))))
    codes_of_robot = codes(replace(robot, links=(robot.links[0], odd, *robot.links[2:])))
    assert ("inertia-impossible" not in codes_of_robot) is possible
