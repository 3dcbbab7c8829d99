"""Plans the motions of a joint log that settles the values that a first log leaves open.

The information of a steady motion about the parameters does not depend on measured values, only on
the directions of the wheels.  The plan adds seconds of simple motions to the information of the
log, always of the motion that reduces the largest open standard error most, until all values are
settled (greedy E-optimal design).  The noise is that of the log.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from thorvaldc.model import Robot
from thorvaldc.model.spatial import float_sum
from thorvaldc.runtime.calculators import for_robot
from thorvaldc.runtime.calculators.base_calculator import BaseCalculator
from thorvaldc.runtime.se2 import Twist
from thorvaldc.tools.calibration.log_intervals import Array

SPEED = 0.5
"""Speed (m/s) of the planned motions."""
LONGEST = 1800.0
"""A log that must be longer than this time (s) is not planned."""
_STEP = 10.0  # s
_GROWTH = 0.15
_SAME = 1e-3
"""Twists within this distance (m/s, rad/s) are equal."""


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """A motion of a log that settles open values: a description and a duration in s."""

    description: str
    seconds: float


@dataclass(frozen=True, slots=True)
class SteadyMotion:
    """A motion with constant joints: wheel speeds (rad/s) and steering angles (rad) by wheel."""

    description: str
    twists: tuple[Twist, ...]
    speeds: Array
    angles: Array


def steady_motions(robot: Robot, length: float) -> Iterator[SteadyMotion]:
    """Yields the simple motions that the robot can make.

    ``length`` is a length (m) of the order of the wheelbase.
    """
    calculator = for_robot(robot)
    near, wide = SPEED / (1.5 * length), SPEED / (5.0 * length)
    for description, twists in (
        ("straight on", [(SPEED, 0.0, 0.0)]),
        ("sideways", [(0.0, SPEED, 0.0)]),
        ("diagonally, to both sides", [(0.7 * SPEED, y * SPEED, 0.0) for y in (0.7, -0.7)]),
        ("in wide circles to both sides", [(SPEED, 0.0, wide), (SPEED, 0.0, -wide)]),
        ("in narrow circles to both sides", [(SPEED, 0.0, near), (SPEED, 0.0, -near)]),
        ("on the spot, in both directions", [(0.0, 0.0, 1.5 * near), (0.0, 0.0, -1.5 * near)]),
    ):
        feasible = [calculator.feasible(Twist(*twist)) for twist in twists]
        states = [
            _joints(calculator, twist) if _similar(twist, Twist(*commanded)) else None
            for twist, commanded in zip(feasible, twists, strict=True)
        ]
        reachable = [state for state in states if state is not None]
        if len(reachable) == len(twists):
            yield SteadyMotion(
                description,
                tuple(feasible),
                np.array([speeds for speeds, _ in reachable]),
                np.array([angles for _, angles in reachable]),
            )


def _similar(twist: Twist, commanded: Twist) -> bool:
    """Returns whether a feasible twist keeps most of the commanded velocity and yaw rate."""
    along = twist.vx * commanded.vx + twist.vy * commanded.vy
    turning = twist.wz * commanded.wz
    return along >= 0.5 * commanded.speed**2 and turning >= 0.5 * commanded.wz**2


def _joints(
    calculator: BaseCalculator, twist: Twist
) -> tuple[Sequence[float], Sequence[float]] | None:
    """Returns wheel speeds and steering angles for a twist, or ``None`` if it is not reachable."""
    command = calculator.command(twist)
    missed = max(abs(a - b) for a, b in zip(command.target, twist, strict=True))
    if command.unreachable or missed > _SAME:
        return None
    return command.joints.speeds, command.joints.angles


def plan_motions(
    covariance: Array,
    targets: Array,
    limits: Array,
    candidates: Sequence[tuple[str, Array]],
) -> tuple[PlannedMotion, ...] | None:
    """Returns the motions after which all target variances are at most their limits.

    - ``covariance``: covariance of the parameters after the first log.
    - ``targets``: one row per open value; its value is the product of the row and the parameters.
    - ``limits``: largest settled variance of each open value.
    - ``candidates``: description and information matrix per second of each motion.

    Returns ``None`` if no motions of at most ``LONGEST`` s settle all open values.
    """
    # Errors below 1e-6 do not matter, and keep the matrix regular.
    information: Array = np.asarray(
        np.linalg.inv(covariance + 1e-12 * np.eye(len(covariance))), dtype=np.float64
    )
    seconds = [0.0] * len(candidates)

    def excess(matrix: Array) -> float:
        variances = np.einsum("op,pq,oq->o", targets, np.linalg.inv(matrix), targets)
        return float(np.max(variances / limits))

    while excess(information) > 1.0:
        total = float_sum(seconds)
        if total > LONGEST or not candidates:
            return None
        step = max(_STEP, _STEP * math.floor(_GROWTH * total / _STEP))
        scores = [excess(information + step * per_second) for _, per_second in candidates]
        best = int(np.argmin(scores))
        seconds[best] += step
        information = information + step * candidates[best][1]
    return tuple(
        PlannedMotion(description, duration)
        for (description, _), duration in zip(candidates, seconds, strict=True)
        if duration > 0.0
    )


def plan_text(motions: Sequence[PlannedMotion]) -> str:
    """Returns the motions as a text such as "20 s sideways and 35 s straight on"."""
    parts = [f"{motion.seconds:g} s {motion.description}" for motion in motions]
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
