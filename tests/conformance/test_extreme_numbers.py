"""Any finite numbers, however large, small or contradictory: finite results or an error."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from tests.slow import mostly_exhaustive
from thorvaldc.runtime.base_interface import JointStates, NotFiniteError
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.general import General, GeneralOptions
from thorvaldc.runtime.se2 import Twist

SQUARE = ((0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4))
ROBOTS = {
    "four steered": [wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate(SQUARE)],
    "beside their axes": [
        wheel(f"w{i}", x, y, "steered", lateral=0.1) for i, (x, y) in enumerate(SQUARE)
    ],
    "two steered, two fixed": [
        wheel(f"w{i}", x, y, "steered" if x > 0.0 else "fixed") for i, (x, y) in enumerate(SQUARE)
    ],
}
NOISE = ("speed_ratio", "angle", "speed_floor", "slip_floor", "gyro")


def value(chance: random.Random, largest: float) -> float:
    """Ordinary, zero, next to nothing, or of any size."""
    kind = chance.randrange(4)
    if kind == 0:
        return chance.uniform(-5.0, 5.0)
    if kind == 1:
        return chance.choice([0.0, -0.0, 1e-300, 5e-324, 1e-155, 1e-30])
    return chance.choice([1.0, -1.0]) * 10.0 ** chance.uniform(-320.0, largest)


@pytest.mark.parametrize("part", mostly_exhaustive(range(3)))
@pytest.mark.parametrize("largest", [308.0, 8.9, 3.0])
@pytest.mark.parametrize("name", ROBOTS)
def test_results_are_finite_or_refused(name: str, largest: float, part: int) -> None:
    chance = random.Random(f"{name} {largest} {part}")
    geometry = BaseGeometry.from_wheels(ROBOTS[name])
    n = len(geometry.wheels)

    def joints(count: int) -> list[float]:
        return [value(chance, largest) for _ in range(count)]

    for trial in range(20):
        noise = Noise()
        if trial % 2:
            size = {key: 10.0 ** chance.uniform(-320.0, 308.0) or 1.0 for key in NOISE}
            noise = replace(noise, **size)
        calculator = General(geometry, GeneralOptions(polish=2 * (trial % 3)), noise)
        states = JointStates(0.0, joints(n), joints(n), [0.0] * n)
        try:
            estimate = calculator.odometry(states)
            numbers = (*estimate.twist, *sum(estimate.covariance, ()), *estimate.chi_squares)
            assert all(map(math.isfinite, numbers))
        except NotFiniteError:
            pass
        try:
            command = calculator.command(Twist(*joints(3)), states, 0.02)
            numbers = (*command.joints.speeds, *command.joints.angles, *command.twist)
            assert all(map(math.isfinite, numbers))
        except NotFiniteError:
            pass
