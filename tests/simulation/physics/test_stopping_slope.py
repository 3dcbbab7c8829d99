"""Robots that stop on a slope in MuJoCo, compared with the closed form of the model."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import pytest

from bench.stopping_slope import (
    CASES,
    FAMILIES,
    GENTLE,
    ROVER,
    WEAK,
    Case,
    steepest_stop,
    stopping_distances,
)
from tests.examples import example_robot
from thorvaldc.model.statics.slope import directions_of

pytest.importorskip("mujoco")


@pytest.mark.parametrize(
    "case",
    [
        Case("1wd1ws_front", 12.0, "backwards"),
        Case(ROVER, 14.0, "backwards"),
        Case(WEAK, 12.0, "forwards"),
        Case("4wd4ws_wide", 25.0, "backwards"),
    ],
    ids=["one of three", "two of four", "weak motors", "four of four"],
)
def test_the_closed_form_agrees_with_mujoco(case: Case) -> None:
    assert case in CASES
    model, measured = stopping_distances(case)
    assert model == pytest.approx(measured, rel=0.1)


def test_a_robot_that_cannot_brake_does_not_stop() -> None:
    # On 15 deg it turns aside first, and chance decides whether it comes to rest across the slope.
    assert stopping_distances(Case("1wd1ws_rear", 16.0, "forwards")) == (math.inf, math.inf)


TALL = ROVER.replace("xyz: [-100 mm, 0, 70 mm]", "xyz: [100 mm, 0, 1.2 m]").replace(
    "  caster_left: {type: caster/swivel, mount: frame.rear_left}\n"
    "  caster_right: {type: caster/swivel, mount: frame.rear_right}\n",
    "  caster: {type: caster/swivel, mount: frame.rear_center}\n",
)
"""Three wheels below a battery 1.2 m above the frame."""


@pytest.mark.parametrize(
    "driver",
    [
        "{stopping_distance: 20 m, command_timeout: 0.5 s}",  # far less than the ramp would do
        pytest.param("{max_linear_deceleration: 0.25 m/s^2}", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("direction", ["forwards", "backwards"])
def test_a_tall_robot_does_not_tip_over_on_the_stated_slope(driver: str, direction: str) -> None:
    assert steepest_stop(TALL, direction, driver=driver).longer < 0.03


def stops() -> Iterator[Any]:
    """Yields each robot, direction, load and ramp.

    One of twelve pairs of robot and direction is quick.  Of the other pairs, CI has two of the four
    combinations of load and ramp, by turns, so that each load and each ramp is among them.
    """
    ways = [(name, way) for name in FAMILIES for way in directions_of(example_robot(name))]
    for index, (name, way) in enumerate(ways):
        for block, gentle in itertools.product((False, True), repeat=2):
            is_in_ci = (block == gentle) == (index % 2 == 0)
            group = pytest.mark.slow if is_in_ci else pytest.mark.exhaustive
            kind = f"{'loaded' if block else 'as_it_is'}-{'gentle' if gentle else 'own_ramp'}"
            marks = [group] if index % 12 else []
            yield pytest.param(name, way, block, gentle, marks=marks, id=f"{name}-{way}-{kind}")


@pytest.mark.parametrize(("name", "direction", "block", "gentle"), list(stops()))
def test_the_stated_slope_holds(name: str, direction: str, block: bool, gentle: bool) -> None:
    """The stop is no longer than on level ground, and the robot does not tip over."""
    driver = f"{{max_linear_deceleration: {GENTLE} m/s^2}}" if gentle else ""
    closing = steepest_stop(name, direction, block=block, driver=driver)
    assert closing.longer < 0.06, closing
