"""The bare kinematics agree with the calculator and with the estimator."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.calculators.kinematics import Kinematics
from thorvaldc.runtime.se2 import Twist


def robots() -> list[BaseGeometry]:
    rng = random.Random(3)
    return [
        BaseGeometry.from_wheels(
            [
                wheel(
                    f"w{i}",
                    rng.uniform(-2.0, 2.0),
                    rng.uniform(-2.0, 2.0),
                    "swivel" if i and rng.random() < 0.3 else "steered",
                    heading=rng.choice([0.0, 0.0, 0.3, math.pi]),
                    sign=rng.choice([1.0, -1.0]),
                    radius=rng.choice([0.1, 0.2]),
                    limits=(None, None),
                )
                for i in range(n)
            ]
        )
        for n in (2, 3, 4, 6, 9, 20)
    ]


def random_twist(rng: random.Random) -> Twist:
    return Twist(*(rng.uniform(-1.0, 1.0) for _ in range(3)))


def velocities(
    geometry: BaseGeometry, speeds: tuple[float, ...], angles: tuple[float, ...]
) -> list[tuple[float, float]]:
    found = []
    for w, v, a in zip(geometry.wheels, speeds, angles, strict=True):
        direction = w.heading + w.sign * a
        found.append((w.radius * v * math.cos(direction), w.radius * v * math.sin(direction)))
    return found


@pytest.mark.parametrize("geometry", robots(), ids=lambda g: f"{len(g.wheels)} wheels")
def test_inverse_gives_every_wheel_the_velocity_of_its_place(geometry: BaseGeometry) -> None:
    made, rng = Kinematics(geometry), random.Random(4)
    free = [replace(w, max_speed=1e3) for w in geometry.wheels]
    calculator = General(BaseGeometry.from_wheels(free))
    for _ in range(10):
        twist = random_twist(rng)
        speeds, angles = made.inverse(*twist)
        joints = calculator.command(twist).joints
        theirs = velocities(geometry, (*joints.speeds,), (*joints.angles,))
        for w, own, its in zip(
            geometry.wheels, velocities(geometry, speeds, angles), theirs, strict=True
        ):
            place = (twist.vx - twist.wz * w.y, twist.vy + twist.wz * w.x)
            if w.steered:
                assert own == pytest.approx(place, abs=1e-12)
                assert own == pytest.approx(its, abs=1e-12)
            else:
                assert own == its == (0.0, 0.0)


@pytest.mark.parametrize("geometry", robots(), ids=lambda g: f"{len(g.wheels)} wheels")
def test_least_squares_is_that_of_the_estimator(geometry: BaseGeometry) -> None:
    made, rng = Kinematics(geometry), random.Random(5)
    calculator = General(geometry)
    if sum(not w.swivel for w in geometry.wheels) < 2:
        return
    for _ in range(10):
        twist = random_twist(rng)
        speeds, angles = made.inverse(*twist)
        assert made.least_squares(speeds, angles) == pytest.approx(twist, abs=1e-11)
        noisy = [v * (1.0 + rng.gauss(0.0, 0.05)) for v in speeds]
        states = JointStates(0.0, noisy, angles, [0.0] * len(noisy))
        own = calculator.estimator.least_squares(states)
        assert made.least_squares(noisy, angles) == pytest.approx(own, abs=1e-11)


def test_fixed_wheels_roll_along() -> None:
    wheels = [
        wheel("l", 0.2, 0.4, "fixed"),
        wheel("r", 0.2, -0.4, "fixed", heading=math.pi),
        wheel("f", 1.0, 0.0, "steered"),
    ]
    made = Kinematics(BaseGeometry.from_wheels(wheels))
    twist = (0.6, -0.2 * 0.3, 0.3)
    speeds, angles = made.inverse(*twist)
    assert speeds[:2] == pytest.approx(((0.6 - 0.12) / 0.2, -(0.6 + 0.12) / 0.2))
    assert angles[:2] == (0.0, 0.0)
    assert made.least_squares(speeds, angles) == pytest.approx(twist)


def test_one_wheel_tells_no_turning() -> None:
    made = Kinematics(BaseGeometry.from_wheels([wheel("w", 0.5, 0.1, "steered")]))
    assert made.least_squares((5.0,), (0.0,)) == pytest.approx((1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "wheels",
    [
        [],
        [wheel("c", 0.0, 0.0, "swivel")],
        [wheel("a", 0.5, 0.0, "steered"), wheel("p", 0.0, 0.4, "passive")],
        [wheel("a", 0.5, 0.0, "steered", trail=0.1)],
        [wheel("a", 0.5, 0.0, "steered", lateral=0.1)],
    ],
)
def test_what_it_is_not_for(wheels: list[WheelGeometry]) -> None:
    with pytest.raises(ValueError, match="every wheel must be driven"):
        Kinematics(BaseGeometry.from_wheels(wheels))
