"""Wheel loads and tip-over angles of a robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.robot import Robot
from thorvaldc.model.statics.contact_point import contact_point
from thorvaldc.model.statics.gravity import GRAVITY
from thorvaldc.model.statics.load_ranges import load_ranges
from thorvaldc.model.statics.tip_over import Support, support_of

DIRECTIONS = {
    "front": 0.0,
    "left": math.pi / 2,
    "rear": math.pi,
    "right": -math.pi / 2,
}
"""Directions in rad, from x (forward) to y (left)."""
POLAR_STEPS = 72
"""Number of directions in ``Stability.polar``, 5 degrees apart."""


@dataclass(frozen=True, slots=True)
class WheelLoad:
    """A wheel and its load on level ground.

    - ``name``, ``module``: name of the wheel, and path of its module.
    - ``x``, ``y``: contact point in ``base_link`` in m, with all joints at position 0.
    - ``radius``: rolling radius in m.
    - ``load``: wheel load in N.
    - ``load_range``: smallest and largest load in N that the balance of forces allows, equal for a
      wheel whose load it determines, see ``model.statics.load_ranges``; ``None`` for a robot with
      too many wheels.
    - ``share``: wheel load divided by the weight of the robot.
    - ``driven``, ``steered``: true if a motor drives or steers the wheel.
    """

    name: str
    module: str
    x: si.Metres
    y: si.Metres
    radius: si.Metres
    load: si.Newtons
    load_range: tuple[si.Newtons, si.Newtons] | None
    share: si.Number
    driven: bool
    steered: bool


@dataclass(frozen=True, slots=True)
class TipOver:
    """The angle in rad at which the robot tips over on ground that falls in a direction.

    ``direction`` is in rad from x (forward) to y (left) in ``base_link``.
    """

    direction: si.Radians
    angle: si.Radians


@dataclass(frozen=True, slots=True)
class Stability:
    """Whether a robot stands, and the angles at which it tips over.

    ``model.statics.tip_over`` derives the angles and states the assumptions.

    - ``stands``: true if the centre of mass is above the inside of the support polygon.
    - ``margin``: distance of the centre of mass from the nearest edge of the support polygon in m,
      negative outside, or ``None`` if the contact points do not span an area.
    - ``angles``: tip-over angle in rad by the name of the direction, see ``DIRECTIONS``.
    - ``least``: the smallest tip-over angle of all directions, or ``None`` for a robot that does
      not stand.
    - ``polar``: tip-over angles at equal steps of the direction, beginning at the front; empty for
      a robot that does not stand.
    """

    stands: bool
    margin: si.Metres | None
    angles: tuple[tuple[str, si.Radians], ...]
    least: TipOver | None
    polar: tuple[TipOver, ...]


def wheel_loads_of(robot: Robot) -> tuple[WheelLoad, ...]:
    """Return the wheels of a robot with their loads, in the order of the model."""
    weight = robot.inertial.mass * GRAVITY
    ranges = load_ranges(robot) or [None] * len(robot.wheels)
    return tuple(
        WheelLoad(
            wheel.name,
            wheel.module,
            *contact_point(wheel),
            wheel.radius,
            wheel.load,
            load_range,
            wheel.load / weight if weight > 0.0 else 0.0,
            wheel.driven,
            wheel.steered,
        )
        for wheel, load_range in zip(robot.wheels, ranges, strict=True)
    )


def stability_of(robot: Robot) -> Stability:
    """Return the tip-over angles of a robot with all joints at position 0."""
    support = support_of(robot)
    return Stability(
        stands=support.stands,
        margin=support.margin if support.edges else None,
        angles=tuple((name, support.tip_over_angle(u)) for name, u in DIRECTIONS.items()),
        least=TipOver(*support.least_tip_over()) if support.stands else None,
        polar=tuple(_polar(support)) if support.stands else (),
    )


def _polar(support: Support) -> list[TipOver]:
    directions = [math.tau * step / POLAR_STEPS for step in range(POLAR_STEPS)]
    return [TipOver(u, support.tip_over_angle(u)) for u in directions]
