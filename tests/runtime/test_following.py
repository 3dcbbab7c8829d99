"""Random robots follow random twists, or report what they cannot make."""

from __future__ import annotations

import random

import pytest

from bench import crossing
from bench.following import Conduct, case, follow, random_twists, study
from bench.random_robots import FAMILIES, random_robot
from thorvaldc.runtime.se2 import Twist


def blameless(result: Conduct) -> None:
    assert result.notes == []
    assert result.scrub < 1e-9
    assert result.wrong_twist < 1e-9


@pytest.mark.parametrize("family", FAMILIES)
def test_robots_follow_the_reachable_part_of_every_twist(family: str) -> None:
    """``python -m bench.following`` drives 60 robots of each family."""
    result = study(1, family)
    assert result.limited or FAMILIES[family].limit is None or FAMILIES[family].limit >= 1.5
    blameless(result)


@pytest.mark.parametrize("seed", [12, 20, 43])
def test_rectangle_with_limits_of_90_degrees_moves_sideways(seed: int) -> None:
    """Wheels at +90 and -90 deg are equally good: they must not change between both."""
    rng = random.Random(seed)
    robot = random_robot(FAMILIES["rectangle, +-90 deg"], rng)
    start = random_twists(rng)[0]
    blameless(follow(robot, [start, Twist(0.0, 0.5, 0.0), Twist(0.0, -0.5, 0.0)]))


@pytest.mark.parametrize(
    ("family", "number", "twists"),
    [
        ("random, +-90 deg, trail", 48, slice(0, 2)),  # a target angle just beyond a limit
        ("random, +-120 deg, trail", 3, slice(0, 2)),  # a wheel with trail turns the long way
        ("random, +-120 deg, trail", 47, slice(0, 6)),  # a wheel at its speed limit
        ("random, unlimited, trail", 9, slice(0, 1)),  # large offsets of the contact points
        ("random, unlimited, trail", 6, slice(0, 1)),
        ("random, +-35 deg, offsets", 9, slice(0, 6)),
        ("car, +-60 deg, trail", 4, slice(1, 3)),
    ],
)
def test_robots_that_were_difficult(family: str, number: int, twists: slice) -> None:
    robot, sequence = case(family, number)
    blameless(follow(robot, sequence[twists]))


@pytest.mark.parametrize(
    ("family", "number", "twists"),
    [
        ("random, +-90 deg, trail", 11, slice(6, 8)),
        ("random, +-120 deg, trail", 10, slice(4, 6)),
        ("random, unlimited, trail", 0, slice(0, 4)),
    ],
)
def test_centre_of_rotation_crosses_the_circle_of_a_contact_point(
    family: str, number: int, twists: slice
) -> None:
    """``python -m bench.crossing`` drives 20 robots of each family.

    Two of these robots stopped at the near edge of the circle for ever.
    """
    robot, sequence = crossing.case(family, number)
    blameless(follow(robot, sequence[twists]))
