"""The compensation of skidding, for wheels that are neither centred nor evenly spaced."""

from __future__ import annotations

import math

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.calculators import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.base_geometry import FixedWheels
from thorvaldc.runtime.calculators.reachable_twists import SkidSteering
from thorvaldc.runtime.se2 import Twist

PLACES = [(0.5, 0.6, "fixed"), (0.5, -0.2, "fixed"), (-0.3, 0.5, "passive"), (-0.7, -0.2, "fixed")]


def wheels(angle: float = 0.0) -> list[WheelGeometry]:
    c, s = math.cos(angle), math.sin(angle)
    return [
        wheel(f"w{i}", c * x - s * y, s * x + c * y, kind, heading=angle)
        for i, (x, y, kind) in enumerate(PLACES)
    ]


def compensation(robot: list[WheelGeometry]) -> SkidSteering | None:
    return SkidSteering.from_geometry(BaseGeometry.from_wheels(robot), FixedWheels(robot))


@pytest.mark.parametrize("angle", [0.0, 0.8])
def test_the_rotation_is_enlarged_about_the_middle_of_the_driven_wheels(angle: float) -> None:
    skid = compensation(wheels(angle))
    assert skid is not None
    driven = [y for _, y, kind in PLACES if kind == "fixed"]
    middle = sum(driven) / 3
    turning = sum((y - middle) ** 2 for y in driven)
    mean = sum(x for x, _, _ in PLACES) / 4
    resisting = sum((x - mean) ** 2 for x, _, _ in PLACES)
    added = 0.4 * resisting / turning
    c, s = math.cos(angle), math.sin(angle)
    twist = skid.compensate(Twist(0.7, 0.2, 0.4))
    assert twist.wz == pytest.approx(0.4 + added)
    assert (twist.vx, twist.vy) == pytest.approx(
        (0.7 + c * added * middle, 0.2 + s * added * middle)
    )
    # The mean speed of the driven wheels is that of the commanded twist.
    rows = [w.rows(0.0)[0] for w in wheels(angle) if w.driven]
    speeds = [sum(a * b for a, b in zip(row, twist, strict=True)) for row in rows]
    before = [sum(a * b for a, b in zip(row, (0.7, 0.2, 0.4), strict=True)) for row in rows]
    assert sum(speeds) == pytest.approx(sum(before))


def test_robots_that_do_not_skid_need_no_compensation() -> None:
    assert compensation([w for w in wheels() if w.x > 0.0]) is None, "one axle"
    assert compensation([*wheels(), wheel("s", 1.0, 0.0, "steered")]) is None
    assert compensation([*wheels(), wheel("t", 1.0, 0.0, "fixed", heading=0.5)]) is None
    in_line = [wheel(f"w{i}", x, 0.0, "fixed") for i, x in enumerate((0.4, -0.4))]
    assert compensation(in_line) is None, "driven wheels in line cannot turn the robot"
