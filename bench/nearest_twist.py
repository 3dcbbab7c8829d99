"""Compares the reachable twist of the calculator with the nearest reachable twist.

The calculator replaces a twist that the steering limits exclude by rules that keep the direction of
the velocity and never reverse the robot (``reachable_twists``).  The study compares its distance
from the feasible part of the command with that of the nearest reachable twist, in m/s, with the yaw
rate times the mean distance of the wheels.  A search over all directions of the twist finds the
nearest one: the reachable twists are a double cone, so the best multiple of a direction u of length
1 is (u . commanded) u.

``python -m bench.nearest_twist [ROBOTS]`` compares this number of robots of each family, by
default 30.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterator
from statistics import median
from typing import TYPE_CHECKING, Any

from bench.figure import Figure
from bench.following import random_twists
from bench.random_robots import FAMILIES, random_robot

GROUP = "long"

if TYPE_CHECKING:
    from thorvaldc.runtime.calculators import BaseGeometry
    from thorvaldc.runtime.calculators.base_geometry import FixedWheels
    from thorvaldc.runtime.se2 import Twist

ROBOTS = 30
"""Robots of each family in the study."""
SAMPLE = 6
"""Robots of each family in the bench."""
_SMALLEST = 0.05
"""Commands that are nearer (m/s) to a reachable twist are not compared."""
_TOLERANCE = 1e-9


def ratios(robots: int, family: str) -> list[float]:
    """Returns the distance of the calculator's twist, as a multiple of the least distance."""
    from thorvaldc.runtime.calculators import BaseGeometry
    from thorvaldc.runtime.calculators.base_geometry import FixedWheels
    from thorvaldc.runtime.calculators.reachable_twists import ReachableTwists

    result = []
    for number in range(robots):
        rng = random.Random(700_000 + list(FAMILIES).index(family) * 1000 + number)
        robot = random_robot(FAMILIES[family], rng)
        geometry = BaseGeometry.from_robot(robot)
        fixed = FixedWheels(geometry.wheels)
        for twist in random_twists(rng):
            commanded = fixed.feasible(twist)
            target, limiting = ReachableTwists(geometry, fixed).project(commanded)
            if not limiting:
                continue
            least = nearest_distance(geometry, fixed, commanded)
            if least >= _SMALLEST:
                gap = [a - b for a, b in zip(target, commanded, strict=True)]
                result.append(math.hypot(gap[0], gap[1], geometry.length * gap[2]) / least)
    return result


def nearest_distance(geometry: BaseGeometry, fixed: FixedWheels, commanded: Twist) -> float:
    """Returns the distance (m/s) from ``commanded`` to the nearest reachable twist."""
    import numpy as np

    length = geometry.length
    weights = np.array([1.0, 1.0, length * length])
    goal = np.array(commanded)
    best, best_angles = math.sqrt(float(goal @ (weights * goal))), (0.0, 0.0)
    one_axle = not fixed.unconstrained
    azimuths, elevations, step = np.linspace(-math.pi, math.pi, 361), np.zeros(1), 0.02
    if not one_axle:
        elevations = np.linspace(-math.pi / 2.0, math.pi / 2.0, 181)
    for _ in range(4):
        a, e = (grid.ravel() for grid in np.meshgrid(azimuths, elevations))
        if one_axle:
            nx, ny, d = fixed.rows[0]
            along, turn = np.cos(a), np.sin(a) / length
            u = np.array([ny * along - d * nx * turn, -nx * along - d * ny * turn, turn])
            u = u / np.sqrt(weights @ (u * u))
        else:
            u = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e) / length])
        size = np.maximum((goal * weights) @ u, 0.0)
        gaps = weights @ (size * u - goal[:, None]) ** 2
        gaps[~_reachable(geometry, u)] = math.inf
        i = int(gaps.argmin())
        if math.sqrt(gaps[i]) < best:
            best, best_angles = math.sqrt(gaps[i]), (float(a[i]), float(e[i]))
        azimuths = best_angles[0] + np.linspace(-step, step, 41)
        elevations = best_angles[1] + (np.zeros(1) if one_axle else np.linspace(-step, step, 41))
        step /= 10.0
    return best


def _reachable(geometry: BaseGeometry, twists: Any) -> Any:
    """Returns which of the twists, shape (3, n), all steered wheels allow."""
    import numpy as np

    allowed = np.ones(twists.shape[1], bool)
    for group in geometry.steering_groups:
        wheel = geometry.wheels[group[0]]
        ux, uy = twists[0] - twists[2] * wheel.y, twists[1] + twists[2] * wheel.x
        bend, speed = twists[2] * wheel.trail, np.hypot(ux, uy)
        lead = np.arcsin(np.clip(bend / np.maximum(speed, 1e-12), -1.0, 1.0))
        direction = np.arctan2(uy, ux) - wheel.heading
        within = np.zeros_like(allowed)
        for angle in (direction + lead, direction - lead + math.pi):
            joint = wheel.sign * angle
            if wheel.lower is None or wheel.upper is None:
                within[:] = True
                continue
            turns = np.ceil((wheel.lower - _TOLERANCE - joint) / math.tau)
            within |= joint + turns * math.tau <= wheel.upper + _TOLERANCE
        allowed &= (within & (np.abs(bend) <= speed)) | (speed < _TOLERANCE)
    return allowed


def figures() -> Iterator[Figure]:
    values = [ratio for family in FAMILIES for ratio in ratios(SAMPLE, family)]
    how = f"distance to the command / least distance, {len(values)} unreachable twists of "
    how += f"{SAMPLE * len(FAMILIES)} random robots"
    yield Figure("reachable twist, median", median(values), "x nearest", 1.3, "lower", how)
    yield Figure("reachable twist, largest", max(values), "x nearest", None, "lower", how)


def main(robots: int) -> None:
    """Prints the ratios of all families."""
    for family in FAMILIES:
        if values := sorted(ratios(robots, family)):
            high = values[int(0.9 * len(values))]
            print(
                f"{family:<30} {len(values):4} unreachable twists: median {median(values):.2f}, "
                f"90 % {high:.2f}, largest {values[-1]:.2f} times the least distance",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else ROBOTS)
