"""Robots with trail follow twists whose way leads across a steering axis.

A wheel with trail cannot turn about a point within the circle of its contact point around the
steering axis.  On the straight way between two reachable twists, the centre of rotation may have to
cross this circle.  The driver, the calculator and ideal joints must bring every robot across, and
the driver must not report a twist that is followed in the end.

``python -m bench.crossing [ROBOTS]`` drives this number of robots of each family, by default 20:
about 1,000 twists.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from bench.figure import Figure
from bench.following import Conduct, follow, row
from bench.random_robots import FAMILIES, random_robot

GROUP = "long"

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.runtime.se2 import Twist

ROBOTS = 20
"""Robots of each family in the study."""
SAMPLE = 1
"""Robots of each family in the bench."""
CROSSINGS = 5
"""Pairs of twists of each robot."""
_ATTEMPTS = 300
"""Attempts to find pairs of twists; robots with narrow limits have few of them."""

TRAILING = [name for name, family in FAMILIES.items() if family.trail and family.layout != "car"]


def crossing_twists(robot: Robot, rng: random.Random) -> list[Twist]:
    """Returns pairs of reachable twists with a steering axis between their centres of rotation.

    The straight line between the two centres of rotation cuts the circle of the contact point.
    """
    from thorvaldc.runtime.driver import BaseDriver
    from thorvaldc.runtime.se2 import Twist
    from thorvaldc.simulation.physics.sim_base import SimBase

    driver = BaseDriver(robot, SimBase(robot))
    wheels = [w for w in driver.calculator.geometry.wheels if w.steered and w.trail]
    twists: list[Twist] = []
    for _ in range(_ATTEMPTS):
        wheel = rng.choice(wheels)
        radius = abs(wheel.trail)
        beside = rng.uniform(-radius, radius)  # from the steering axis to the straight line
        near, far = (radius * math.exp(rng.uniform(0.02, 2.5)) for _ in range(2))
        start = rng.uniform(-math.pi, math.pi)
        end = start + math.pi - math.asin(beside / near) - math.asin(beside / far)
        wz = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.8)
        last_wz = math.copysign(rng.uniform(0.1, 0.8), wz) if rng.random() < 0.2 else wz
        pair = [
            Twist(
                rate * (wheel.y + distance * math.sin(angle)),
                -rate * (wheel.x + distance * math.cos(angle)),
                rate,
            )
            for distance, angle, rate in ((near, start, wz), (far, end, last_wz))
        ]
        if all(driver.limited(twist) == twist for twist in pair):
            twists += pair
        if len(twists) >= 2 * CROSSINGS:
            break
    return twists


def case(family: str, number: int) -> tuple[Robot, list[Twist]]:
    """Returns a random robot of a family, by its number, and its twists."""
    rng = random.Random(500_000 + list(FAMILIES).index(family) * 1000 + number)
    robot = random_robot(FAMILIES[family], rng)
    return robot, crossing_twists(robot, rng)


def study(robots: int, family: str) -> Conduct:
    """Returns the conduct of the first ``robots`` random robots of a family."""
    total = Conduct()
    for number in range(robots):
        robot, sequence = case(family, number)
        total.add(follow(robot, sequence, f"robot {number}"))
    return total


def figures() -> Iterator[Figure]:
    total = Conduct()
    for family in TRAILING:
        total.add(study(SAMPLE, family))
    how = f"{total.twists} twists with a steering axis between two centres of rotation"
    yield Figure("twists across an axis, missed", total.off, "", 0, "lower", how)
    yield Figure("followed but reported", total.misreported, "", 0, "lower", how)


def main(robots: int) -> None:
    """Prints the conduct of all families."""
    total = Conduct()
    for family in TRAILING:
        result = study(robots, family)
        total.add(result)
        print(row(family, result), *result.notes, sep="\n  ", flush=True)
    print(row("all", total))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else ROBOTS)
