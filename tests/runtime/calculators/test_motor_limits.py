"""Wheel speeds within the speed and acceleration limits of the drive motors."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.runtime.calculators.steering_branch import DriveMotors
from thorvaldc.runtime.se2 import Twist

LIMITS = [(4.0, 2.0), (8.0, 1.0)]
"""Largest speed (rad/s) and acceleration (rad/s^2) of the left and the right wheel."""
TWIST = Twist(1.0, 0.5, -0.25)


def motors() -> DriveMotors:
    driven = [
        replace(wheel(name, 0.0, y, "fixed"), max_speed=speed, max_acceleration=acceleration)
        for (speed, acceleration), name, y in zip(LIMITS, "lr", (0.5, -0.5), strict=True)
    ]
    passive = wheel("passive", -0.5, 0.0, "passive")
    return DriveMotors(BaseGeometry.from_wheels([passive, *driven]))


@pytest.mark.parametrize(
    ("speeds", "pushes", "scale"),
    [
        ([99.0, 4.0, 8.0], None, 1.0),
        ([0.0, 8.0, 8.0], None, 0.5),
        ([0.0, -8.0, 4.0], None, 0.5),
        ([0.0, 1.0, -32.0], None, 0.25),
        ([0.0, 8.0, 64.0], None, 0.125),
        # A push in the direction of the wheel leaves less speed for the rolling.
        ([0.0, 4.0, 0.0], [0.0, 2.0, 0.0], 0.5),
        ([0.0, -4.0, 0.0], [0.0, -2.0, 0.0], 0.5),
        ([0.0, 6.0, 0.0], [0.0, -2.0, 0.0], 1.0),
        ([0.0, 4.0, 0.0], [0.0, 5.0, 0.0], 0.0),
    ],
)
def test_all_speeds_are_scaled_to_the_limit_of_one(
    speeds: list[float], pushes: list[float] | None, scale: float
) -> None:
    twist, limited = motors().limit_speeds(TWIST, speeds, pushes)
    assert limited == [scale * v for v in speeds]
    assert twist == TWIST.scaled(scale)


@pytest.mark.parametrize(
    ("speeds", "share"),
    [
        ([0.0, 1.0, 0.5], 1.0),
        ([0.0, 2.0, 0.5], 0.5),
        ([0.0, -2.0, 0.5], 0.5),
        ([0.0, 1.0, -2.0], 0.25),
        ([0.0, 4.0, 4.0], 0.125),
    ],
)
def test_all_changes_are_scaled_to_the_acceleration_of_one(
    speeds: list[float], share: float
) -> None:
    drive_motors = motors()
    start, last = Twist(0.2, 0.1, 0.4), [0.0, 1.0, -1.0]
    drive_motors.limit_accelerations(start, last, None)
    requested = [v + v0 for v, v0 in zip(speeds, last, strict=True)]
    twist, limited = drive_motors.limit_accelerations(TWIST, requested, 0.5)
    expected = [v0 + share * v for v, v0 in zip(speeds, last, strict=True)]
    assert limited == pytest.approx(expected)
    assert drive_motors.commanded_speeds == limited
    ends = zip(start, TWIST, strict=True)
    assert tuple(twist) == pytest.approx([a + share * (b - a) for a, b in ends])


@pytest.mark.parametrize(
    ("speed", "push", "limited"),
    [
        (2.0, 0.25, 0.75),  # of a change of 1 rad/s, the push takes 0.25 rad/s
        (-2.0, -0.25, -0.75),
        (2.0, -0.25, 1.25),
        (-2.0, 0.25, -1.25),
        (0.875, 0.5, 0.5),
        (2.0, 1.5, 0.0),
    ],
)
def test_a_push_uses_part_of_the_acceleration(speed: float, push: float, limited: float) -> None:
    drive_motors = motors()
    _, speeds = drive_motors.limit_accelerations(TWIST, [0.0, speed, 0.0], 0.5, [0.0, push, 0.0])
    assert speeds == pytest.approx([0.0, limited + push, 0.0])
    assert drive_motors.rolling_speeds == pytest.approx([0.0, limited, 0.0])
    # The push continues: its change is 0, and all of the acceleration is left.
    _, speeds = drive_motors.limit_accelerations(
        TWIST, [0.0, 10 * speed, 0.0], 0.5, [0.0, push, 0.0]
    )
    step = 1.0 if speed > 0.0 else -1.0
    assert speeds == pytest.approx([0.0, limited + step + push, 0.0])


def test_without_a_period_the_speeds_jump() -> None:
    twist, speeds = motors().limit_accelerations(TWIST, [0.0, 4.0, 4.0], None, [0.0, 1.0, 0.0])
    assert (twist, speeds) == (TWIST, (0.0, 5.0, 4.0))


def test_a_new_calculator_resumes_the_motion_of_its_predecessor() -> None:
    previous, following = motors(), motors()
    previous.limit_accelerations(TWIST, [0.0, 0.5, 0.5], 0.5, [0.0, 0.25, 0.0])
    following.resume(previous)
    assert following.commanded_speeds == previous.commanded_speeds == (0.0, 0.75, 0.5)
    assert following.twist == TWIST
    _, speeds = following.limit_accelerations(TWIST, [0.0, 2.5, 0.5], 0.5, [0.0, 0.25, 0.0])
    assert speeds == pytest.approx((0.0, 1.75, 0.5))
    following.reset()
    assert following.commanded_speeds == (0.0, 0.0, 0.0)
    assert following.twist == Twist(0.0, 0.0, 0.0)


def test_wheels_that_share_a_motor_have_their_mean_speed() -> None:
    wheels = [wheel(name, 0.0, y, "fixed") for name, y in (("a", 0.5), ("b", 0.2), ("c", -0.5))]
    geometry = BaseGeometry.from_wheels(wheels, spin=["one", "two", "one"])
    assert DriveMotors(geometry).average_shared([1.0, 7.0, 4.0]) == [2.5, 7.0, 2.5]
