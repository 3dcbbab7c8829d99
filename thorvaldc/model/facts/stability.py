"""Wheel loads with their ranges, load on soft soil, and tip-over angles of a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from thorvaldc.model import Robot, Wheel
from thorvaldc.model import quantities as si
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import GRAVITY, clean
from thorvaldc.model.statics.ground_contacts import with_ground_contacts
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.standing import standing_of
from thorvaldc.model.statics.static_loads import maximize, null_space, spring_rates
from thorvaldc.model.statics.tip_over import Support, support_of
from thorvaldc.model.sums import float_sum


@dataclass(frozen=True, slots=True)
class SoilLoad:
    """The largest load and pressure of a wheel on level ground.

    The nominal ground pressure of a wheel is its load over the product of its radius and width. It
    compares wheels on soil in which they sink; on firm ground the contact area is smaller.

    - ``wheel_load``: largest wheel load in N.
    - ``pressure``: largest nominal ground pressure in Pa, or ``None`` for a wheel without a width.
    """

    wheel_load: si.Newtons
    pressure: si.Pascals | None


def soil_load_of(robot: Robot) -> SoilLoad | None:
    """Return the load of a robot on the soil, or ``None`` for a robot without wheels."""
    if not robot.wheels:
        return None
    areas = [wheel.radius * wheel.width for wheel in robot.wheels]
    pressures = [
        wheel.load / area for wheel, area in zip(robot.wheels, areas, strict=True) if area > 0.0
    ]
    return SoilLoad(
        wheel_load=max(wheel.load for wheel in robot.wheels),
        pressure=max(pressures) if len(pressures) == len(robot.wheels) else None,
    )


# -- the wheel loads that the balance of forces allows ------------------------------------------
#
# The balances of the weight and of the moments about passive and sprung joints determine the loads
# of some robots, such as one on three wheels, on springs or on rockers with a differential. A rigid
# frame on four wheels has one load more than balances: if a wheel stands on a pebble or the frame
# is twisted, it and the opposite wheel carry more, the others less. All loads N = N_0 + Z y balance
# the robot, where N_0 are any balancing loads and the columns of Z span the null space of the
# balances. The range of a load follows from two linear programs, max and min of N_i with N >= 0.
#
# The loads of springs change on uneven ground. With the stiffness k_i above wheel i, the heights d
# of the ground change the loads by K^(1/2) Z Z^T K^(1/2) d, where the columns of Z are orthonormal,
# and orthogonal to the motions of the body: to k_i^(1/2) (1, x_i, y_i). The range is that of all
# heights within ``UNEVEN``.

_SAME = 1e-4
"""Share of the weight below which the ends of a range are one load."""
UNEVEN = 0.008  # m, height of the ground under a wheel above or below the plane
MOST_WHEELS = 30
"""Robots with more wheels have no ranges: the linear programs would take seconds."""


@once_per_model
def load_ranges(robot: Robot) -> tuple[tuple[float, float], ...] | None:
    """Return the smallest and the largest load in N of each wheel, in the order of the model.

    Other parts on the ground, as of ``with_ground_contacts``, come after the wheels. The loads are
    those that the balances allow, equal for a wheel whose load they determine; of a robot
    with a spring above each wheel, those on ground that is uneven by ``UNEVEN``. Returns ``None``
    for a robot that does not stand, has no wheels or has more than ``MOST_WHEELS``.
    """
    robot = with_ground_contacts(robot)
    if not robot.wheels or len(robot.wheels) > MOST_WHEELS:
        return None
    standing = standing_of(robot)
    if standing is not None and not standing.stands:
        return None
    rates = spring_rates(tree_of(robot), robot.wheels)
    if math.inf not in rates:
        return _ranges_on_springs(robot.wheels, [math.sqrt(rate) for rate in rates])
    loads = [wheel.load for wheel in robot.wheels] if standing is None else standing.loads
    if standing is not None:
        balances, bounds = standing.balances, standing.bounds
    else:
        points = [wheel.contact_point for wheel in robot.wheels]
        balances = [[1.0] * len(points), [x for x, _ in points], [y for _, y in points]]
        bounds = []
    free = null_space(balances, len(loads))
    if not free:
        return tuple((wheel.load, wheel.load) for wheel in robot.wheels)
    total = float_sum(loads)
    ranges = []
    rows = [[-v for v in row] for row in zip(*free, strict=True)]
    rows += [
        [float_sum(a * b for a, b in zip(bound, unit, strict=True)) for unit in free]
        for bound in bounds
    ]
    limits = [*loads, *(standing.slacks if standing is not None else ())]
    split = [[*row, *(-v for v in row)] for row in rows]
    for i, load in enumerate(loads):
        ends = []
        for sign in (-1.0, 1.0):
            objective = [sign * unit[i] for unit in free] + [-sign * unit[i] for unit in free]
            solution, _ = maximize(objective, split, limits)
            change = float_sum(a * b for a, b in zip(objective, solution, strict=True))
            ends.append(max(load + sign * change, 0.0))
        low, high = ends
        is_determined = high - low < _SAME * total
        stated = robot.wheels[i].load
        ranges.append((stated, stated) if is_determined else (clean(low), clean(high)))
    return tuple(ranges)


def _ranges_on_springs(
    wheels: Sequence[Wheel], roots: Sequence[float]
) -> tuple[tuple[float, float], ...]:
    """``roots``: square root of the stiffness of each wheel."""
    points = [(1.0, *wheel.contact_point) for wheel in wheels]
    rows = [[r * v for r, v in zip(roots, row, strict=True)] for row in zip(*points, strict=True)]
    free = null_space(rows, len(wheels))
    ranges = []
    for i, wheel in enumerate(wheels):
        change = (
            UNEVEN
            * roots[i]
            * float_sum(
                root * abs(float_sum(z[i] * z[j] for z in free)) for j, root in enumerate(roots)
            )
        )
        ranges.append((clean(max(wheel.load - change, 0.0)), clean(wheel.load + change)))
    return tuple(ranges)


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
    - ``load_range``: smallest and largest load in N that the balance of forces allows, or that a
      robot on springs has on uneven ground, see ``load_ranges``; ``None`` for a robot with too many
      wheels.
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
    """Return the wheels of a robot with their loads, in the order of the model, and then the other
    parts that stand on the ground."""
    robot = with_ground_contacts(robot)
    weight = robot.inertial.mass * GRAVITY
    ranges = load_ranges(robot) or [None] * len(robot.wheels)
    return tuple(
        WheelLoad(
            wheel.name,
            wheel.module,
            *wheel.contact_point,
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
