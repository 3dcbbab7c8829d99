"""The wheel loads that the balance of forces allows.

The balances of the weight and of the moments about passive and sprung joints determine the loads of
some robots, such as one on three wheels, on springs or on rockers with a differential. A rigid
frame on four wheels has one load more than balances: if a wheel stands on a pebble or the frame is
twisted, it and the opposite wheel carry more, the others less. All loads N = N_0 + Z y balance the
robot, where N_0 are any balancing loads and the columns of Z span the null space of the balances.
The range of a load follows from two linear programs, max and min of N_i with N >= 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Robot
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.contact_point import contact_point
from thorvaldc.model.statics.simplex import maximize
from thorvaldc.model.statics.standing import standing_of

_SAME = 1e-4
"""Share of the weight below which the ends of a range are one load."""
MOST_WHEELS = 30
"""Robots with more wheels have no ranges: the linear programs would take seconds."""


@once_per_model
def load_ranges(robot: Robot) -> tuple[tuple[float, float], ...] | None:
    """Return the smallest and the largest load in N of each wheel, in the order of the model.

    The ends are equal for a wheel whose load the balances determine. Returns ``None`` for a robot
    that does not stand, has no wheels or has more than ``MOST_WHEELS``.
    """
    if not robot.wheels or len(robot.wheels) > MOST_WHEELS:
        return None
    standing = standing_of(robot)
    if standing is not None and not standing.stands:
        return None
    loads = [wheel.load for wheel in robot.wheels] if standing is None else standing.loads
    if standing is not None:
        balances, bounds = standing.balances, standing.bounds
    else:
        points = [contact_point(wheel) for wheel in robot.wheels]
        balances = [[1.0] * len(points), [x for x, _ in points], [y for _, y in points]]
        bounds = []
    free = _null_space(balances, len(loads))
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


def _null_space(rows: Sequence[Sequence[float]], n: int) -> list[list[float]]:
    """Return an orthonormal basis of the vectors of length n that are orthogonal to all rows."""
    basis: list[list[float]] = []
    free: list[list[float]] = []
    units = [[1.0 if j == k else 0.0 for j in range(n)] for k in range(n)]
    for vector, is_unit in (*((row, False) for row in rows), *((unit, True) for unit in units)):
        length = math.sqrt(float_sum(v * v for v in vector))
        rest = list(vector)
        for _ in range(2):  # the second pass removes the rounding errors of the first
            for direction in basis:
                share = float_sum(a * b for a, b in zip(rest, direction, strict=True))
                rest = [a - share * b for a, b in zip(rest, direction, strict=True)]
        remainder = math.sqrt(float_sum(v * v for v in rest))
        if remainder > 1e-7 * length:
            basis.append([v / remainder for v in rest])
            if is_unit:
                free.append(basis[-1])
    return free
