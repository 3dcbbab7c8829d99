"""Rows of wheels, groups of joints, and the constraint of fixed wheels."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from tests.robots import FOUR_STEERED, make_robot
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.runtime.calculators.base_geometry import FixedWheels
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist


@pytest.mark.parametrize("angle", [0.0, 0.6, -1.3])
def test_rows_are_the_velocity_of_the_contact_point(angle: float) -> None:
    contact = wheel("w", 0.7, -0.4, "steered", heading=0.3, sign=-1.0, trail=-0.08, lateral=0.05)
    direction = 0.3 - angle
    along = math.cos(direction), math.sin(direction)
    across = -along[1], along[0]
    x = 0.7 + along[0] * -0.08 + across[0] * 0.05
    y = -0.4 + along[1] * -0.08 + across[1] * 0.05
    rolling, slip = contact.rows(angle)
    for row, (dx, dy) in ((rolling, along), (slip, across)):
        expected = (dx, dy, dy * x - dx * y)
        assert row == pytest.approx(expected)


def test_centroid_and_length_of_the_wheels_that_guide() -> None:
    wheels = [
        wheel("a", 1.0, 0.5, "steered"),
        wheel("b", 0.0, -0.5, "fixed"),
        wheel("c", -1.0, 0.3, "passive"),
        wheel("caster", 9.0, 9.0, "swivel"),
    ]
    geometry = BaseGeometry.from_wheels(wheels)
    assert geometry.centre == pytest.approx((0.0, 0.1))
    square = (1.0 + 0.16 + 0.36 + 1.0 + 0.04) / 3
    assert geometry.length == pytest.approx(math.sqrt(square))
    alone = BaseGeometry.from_wheels([wheel("a", 0.3, 0.4, "steered")])
    assert alone.length == pytest.approx(0.5)
    close = BaseGeometry.from_wheels(
        [wheel(n, 0.0, y, "fixed") for n, y in (("a", 0.06), ("b", -0.06))]
    )
    assert close.length == pytest.approx(0.06)
    assert BaseGeometry.from_wheels([wheel("a", 0.0, 0.0, "steered")]).length == 0.5
    assert BaseGeometry.from_wheels([]).length == 0.5


def test_wheels_that_share_a_joint() -> None:
    kinds = ("steered", "steered", "fixed", "steered")
    wheels = [wheel(f"w{i}", float(i), 0.0, kind) for i, kind in enumerate(kinds)]
    geometry = BaseGeometry.from_wheels(
        wheels, steering=["left", "right", None, "left"], spin=["s", "t", "s", "u"]
    )
    assert geometry.steering_groups == ((0, 3), (1,))
    assert geometry.spin_groups == ((0, 2),)
    plain = BaseGeometry.from_wheels(wheels)
    assert (plain.steering_groups, plain.spin_groups) == (((0,), (1,), (3,)), ())


def test_limits_of_all_wheels() -> None:
    slow = replace(wheel("a", 0.0, 0.0, "steered"), max_speed=3.0, max_rate=2.0, max_rate_change=8)
    fast = replace(wheel("b", 1.0, 0.0, "fixed", radius=0.5), max_speed=4.0)
    passive = wheel("c", 2.0, 0.0, "passive")
    geometry = BaseGeometry.from_wheels([slow, fast, passive])
    assert [w.name for w in geometry.driven] == ["a", "b"]
    assert geometry.max_wheel_speed == 2.0
    assert geometry.steering_time == 0.25
    unlimited = BaseGeometry.from_wheels([replace(fast, max_speed=math.inf), passive])
    assert (unlimited.max_wheel_speed, unlimited.steering_time) == (1.5, 0.0)
    other = geometry.with_radii([0.1, 0.2, 0.3])
    assert [w.radius for w in other.wheels] == [0.1, 0.2, 0.3]
    assert [w.name for w in other.wheels] == ["a", "b", "c"]
    assert other.length == geometry.length


def test_limits_of_a_robot() -> None:
    robot = cia402_robot()
    wheels = BaseGeometry.from_robot(robot).wheels
    for geometry, model in zip(wheels, robot.wheels, strict=True):
        spin = robot.actuator_of(model.spin_joint)
        steering = robot.actuator_of(model.steering_joint or "")
        assert spin is not None
        assert steering is not None
        assert (geometry.max_speed, geometry.max_acceleration) == (
            spin.max_velocity,
            spin.max_acceleration,
        )
        assert (geometry.max_rate, geometry.max_rate_change) == (
            steering.max_velocity,
            steering.max_acceleration,
        )
        assert (geometry.driven, geometry.steered, geometry.swivel) == (True, True, False)


def test_angles_without_limits_are_those_of_the_motor_controller() -> None:
    robot = cia402_robot()
    joint = robot.wheels[0].steering_joint
    free = replace(
        robot,
        joints=tuple(
            replace(j, lower=None, upper=None) if j.name == joint else j for j in robot.joints
        ),
        actuators=tuple(
            replace(a, encoder_offset=-0.25) if a.joint == joint else a for a in robot.actuators
        ),
    )
    wheel_geometry = BaseGeometry.from_robot(free).wheels[0]
    assert wheel_geometry.upper == pytest.approx(math.pi - 0.25)
    assert wheel_geometry.lower == pytest.approx(0.25 - math.pi)
    without_motor = replace(robot, actuators=tuple(a for a in robot.actuators if a.joint != joint))
    swivel = BaseGeometry.from_robot(without_motor).wheels[0]
    assert (swivel.steered, swivel.swivel) == (False, True)
    simulated = BaseGeometry.from_robot(make_robot(FOUR_STEERED)).wheels[0]
    assert simulated.steered


TWIST = Twist(0.7, -0.3, 0.4)


def test_without_fixed_wheels_every_twist_is_feasible() -> None:
    fixed = FixedWheels([wheel("a", 0.5, 0.0, "steered"), wheel("c", 0.0, 0.3, "swivel")])
    assert fixed.unconstrained
    assert fixed.feasible(TWIST) is TWIST


@pytest.mark.parametrize("heading", [0.0, 0.5])
def test_the_wheels_of_an_axle_do_not_slip(heading: float) -> None:
    """One of the wheels is mounted the other way round."""
    c, s = math.cos(heading), math.sin(heading)
    places = [(-0.4, 0.5, 0.0), (-0.4, -0.3, math.pi)]
    wheels = [
        wheel(f"w{i}", c * x - s * y, s * x + c * y, "fixed", heading=heading + turn)
        for i, (x, y, turn) in enumerate(places)
    ]
    fixed = FixedWheels(wheels)
    assert (len(fixed.rows), fixed.skids) == (1, ())
    twist = fixed.feasible(TWIST)
    assert twist.wz == TWIST.wz
    for w in wheels:
        slip = w.rows(0.0)[1]
        assert slip[0] * twist.vx + slip[1] * twist.vy + slip[2] * twist.wz == pytest.approx(0.0)
    along = c * TWIST.vx + s * TWIST.vy
    assert c * twist.vx + s * twist.vy == pytest.approx(along)


def test_two_axles_turn_about_their_intersection() -> None:
    wheels = [
        wheel("rear", -0.5, 0.0, "fixed"),
        wheel("front", 0.5, 0.0, "fixed", heading=math.atan2(1.0, 2.0)),
    ]
    fixed = FixedWheels(wheels)
    twist = fixed.feasible(TWIST)
    # The lines across the wheels meet at (-0.5, 2).
    assert twist == pytest.approx((2.0 * 0.4, 0.5 * 0.4, 0.4))
    third = wheel("third", 0.0, 0.0, "fixed", heading=math.atan2(0.5, 2.0))
    assert FixedWheels([*wheels, third]).feasible(TWIST) == pytest.approx(twist)
    off = wheel("off", 0.0, 0.3, "fixed", heading=-0.4)
    assert FixedWheels([*wheels, off]).feasible(TWIST) == ZERO_TWIST


def test_wheels_out_of_line_skid() -> None:
    wheels = [wheel(f"w{i}", x, y, "fixed") for i, (x, y) in enumerate([(0.3, 0.4), (0.0, -0.4)])]
    fixed = FixedWheels([wheel("s", 1.0, 0.0, "steered"), *wheels])
    assert fixed.skids == (1, 2)
    (row,) = fixed.rows
    assert row == pytest.approx((0.0, 1.0, 0.15))
