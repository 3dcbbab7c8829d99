"""Computes the static wheel loads (N), the rest positions of springs, and linear programs.

Equations for a standing robot with the weight W (N) and the centre of mass (x, y), where the wheel
i has the contact point (x_i, y_i) and carries the load N_i (N):

    sum N_i = W,   sum N_i x_i = W x,   sum N_i y_i = W y.

For a robot with more than three wheels, the three equations have many solutions.  If all wheels
have the same vertical stiffness and the robot is rigid, the wheel i at (x_i, y_i) carries the load
N_i = a + b x_i + c y_i with the same constants a, b and c for all wheels.  Of all solutions, the
wheel loads N_i = a + b x_i + c y_i have the least sum of squares.

A rocker (a suspension arm on a free joint) adds one equation, because the moments of the wheel
loads about the rocker's joint are in balance.  The loads of a robot with rockers are computed
directly as the least-squares solution.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

from thorvaldc.model import Inertial, Joint, Vec3, Wheel
from thorvaldc.model.spatial import GRAVITY, clean
from thorvaldc.model.statics.joint_tree import (
    JointTree,
    coordinates_of,
    coupled_joints,
    lift,
    lift_of,
)
from thorvaldc.model.sums import float_sum


class Pivot(NamedTuple):
    """A joint without motor and spring, for example the joint of a rocker.

    The moments of the wheel loads and of the weight about the axis of a free joint are in balance.

    Attributes
    ----------
    levers : lever arm (m) of each wheel of the robot about the joint axis.  The lever arm times
        the wheel load is the moment of the wheel load.
    moment : moment (N m) about the joint axis of the weight that the joint carries.
    """

    levers: tuple[float, ...]
    moment: float


def free_pivots(
    tree: JointTree,
    wheels: Sequence[Wheel],
    stopped: Collection[str],
    slope: tuple[float, float] = (0.0, 0.0),
) -> list[Pivot]:
    """Returns the pivots (joints without motor and spring) of a robot, with the joints at 0.

    The spin, steering and swivel joints of wheels are not pivots.  Joints that are coupled to each
    other are one pivot.  ``stopped`` contains the names of the joints that motors or limits hold,
    which are not pivots.  ``slope``: horizontal force on the robot along x and y, over its weight.
    The horizontal forces of the wheels are in proportion to their loads, so that all forces at the
    height z act like vertical ones that are z times ``slope`` further.
    """

    def moved(point: Vec3) -> Vec3:
        x, y, z = point
        return x + z * slope[0], y + z * slope[1], z

    pivots: list[Pivot] = []
    for coordinate in coordinates_of(tree, wheels, stopped, sprung=False):
        levers = [0.0] * len(wheels)
        moment = 0.0
        for joint, ratio, _ in coordinate.members:
            if joint.type == "prismatic":
                levers = [0.0] * len(wheels)
                break
            below = tree.links_below(joint.child)
            links = set(below)
            pose = tree.pose[joint.child]
            frame = moved(pose.xyz), pose.rotate(joint.axis)
            for i, wheel in enumerate(wheels):
                if wheel.link in links:
                    levers[i] += ratio * lift(joint, frame, *wheel.contact_point)
            carried = tree.inertial(below)
            x, y, _ = moved(carried.com)
            lever = lift(joint, frame, x, y)
            moment += ratio * carried.mass * GRAVITY * lever
        if max(map(abs, levers), default=0.0) >= 1e-6:
            pivots.append(Pivot(tuple(levers), moment))
    return pivots


def static_loads(
    points: Sequence[tuple[float, float]], body: Inertial, pivots: Sequence[Pivot] = ()
) -> list[float]:
    """Returns the static wheel load (N) of each wheel of the robot.

    A wheel can push the robot up, but cannot pull the robot down.  A negative wheel load is
    therefore set to 0, and the loads of the other wheels are computed again.  Wheels with contact
    points on one straight line balance only the moment about the normal of the line.

    Parameters
    ----------
    points : contact points (x, y) of the wheels in m.
    body : mass and centre of mass of the whole robot.
    pivots : joints about which the wheel loads are in balance.
    """
    active = list(range(len(points)))
    weight = body.mass * GRAVITY
    loads = [0.0] * len(points)
    while active:
        if pivots:
            solution = least_squares_loads(_balances(points, body, pivots, active))
        else:
            solution = _plane_loads([points[i] for i in active], body.com[:2], weight)
        lowest = min(range(len(active)), key=lambda k: solution[k])
        if solution[lowest] >= -1e-9 * max(weight, 1.0) or len(active) == 1:
            for i, load in zip(active, solution, strict=True):
                loads[i] = max(load, 0.0)
            break
        del active[lowest]
    return loads


def least_squares_loads(balances: Sequence[tuple[list[float], float]]) -> list[float]:
    """Returns the wheel loads (N) with the least sum of squares that balance the weight of the
    robot.

    Each balance of forces or moments is a linear equation ``row . loads = value``.  The
    Gram-Schmidt process makes the rows of the linear equations orthonormal.  A linear equation that
    depends on earlier equations is dropped.  The vector of wheel loads is the sum of each
    orthonormal row times the right-hand side of the equation.
    """
    orthonormal: list[tuple[list[float], float]] = []
    for row, value in balances:
        length = math.sqrt(float_sum(a * a for a in row))
        for direction, share in orthonormal:
            projection = float_sum(a * b for a, b in zip(row, direction, strict=True))
            row = [a - projection * b for a, b in zip(row, direction, strict=True)]
            value -= projection * share
        remainder = math.sqrt(float_sum(a * a for a in row))
        if remainder > 1e-9 * length:
            orthonormal.append(([a / remainder for a in row], value / remainder))
    return [
        float_sum(share * direction[k] for direction, share in orthonormal)
        for k in range(len(balances[0][0]))
    ]


def _balances(
    points: Sequence[tuple[float, float]],
    body: Inertial,
    pivots: Sequence[Pivot],
    active: Sequence[int],
) -> list[tuple[list[float], float]]:
    """Returns the balances of the forces on a robot that stands on its ``active`` wheels."""
    weight = body.mass * GRAVITY
    return [
        ([1.0] * len(active), weight),
        ([points[i][0] for i in active], weight * body.com[0]),
        ([points[i][1] for i in active], weight * body.com[1]),
        *(([pivot.levers[i] for i in active], pivot.moment) for pivot in pivots),
    ]


def _plane_loads(
    points: Sequence[tuple[float, float]], com: tuple[float, float], weight: float
) -> list[float]:
    """Returns the load (N) of each wheel of a robot without rockers.

    The load of the wheel i is N_i = W / n + b (x_i - mean x) + c (y_i - mean y), where W is the
    weight of the robot, n is the number of wheels, and b and c follow from the balance of the
    moments.
    """
    n = len(points)
    mx, my = float_sum(p[0] for p in points) / n, float_sum(p[1] for p in points) / n
    sxx = float_sum((p[0] - mx) ** 2 for p in points)
    syy = float_sum((p[1] - my) ** 2 for p in points)
    sxy = float_sum((p[0] - mx) * (p[1] - my) for p in points)
    dx, dy = com[0] - mx, com[1] - my
    det = sxx * syy - sxy * sxy
    if det > 1e-9 * (sxx + syy) ** 2:
        b = weight * (syy * dx - sxy * dy) / det
        c = weight * (sxx * dy - sxy * dx) / det
    else:
        # Wheels with contact points on one straight line balance only the moment about the normal
        # of the line.  ``least_squares_loads`` would satisfy the balance about x instead.
        trace = sxx + syy
        if trace == 0.0:
            return [weight / n] * n
        angle = 0.5 * math.atan2(2 * sxy, sxx - syy)
        ux, uy = math.cos(angle), math.sin(angle)
        slope = weight * (ux * dx + uy * dy) / trace
        b, c = slope * ux, slope * uy
    return [weight / n + b * (p[0] - mx) + c * (p[1] - my) for p in points]


def null_space(rows: Sequence[Sequence[float]], n: int) -> list[list[float]]:
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


def spring_reference(
    joint: Joint, tree: JointTree, wheels: Sequence[Wheel], loads: Sequence[float]
) -> float:
    """Returns the rest position (m or rad) of the spring in a joint.

    The spring holds the joint at the position 0 under the static wheel loads and the weight of the
    links below the joint::

        stiffness * rest position = -(force or moment of the wheel loads and the weight)

    For a prismatic joint, it is the force along the joint axis; for another joint, the moment about
    the joint axis.  The springs of joints that are coupled to each other carry equal shares of what
    acts on all these joints.
    """
    members = coupled_joints(joint, tree.joints)
    total = float_sum(ratio * _torque(member, tree, wheels, loads) for member, ratio, _ in members)
    springs = len([member for member, _, _ in members if member.stiffness > 0.0])
    return clean(-total / springs / joint.stiffness)


def _torque(
    joint: Joint, tree: JointTree, wheels: Sequence[Wheel], loads: Sequence[float]
) -> float:
    """Returns the force (N) or moment (N m) on a joint of the wheel loads and the weight that it
    carries.
    """
    below = set(tree.links_below(joint.child))
    carried = tree.inertial(sorted(below))
    forces = [
        (load, *wheel.contact_point)
        for wheel, load in zip(wheels, loads, strict=True)
        if wheel.link in below
    ]
    forces.append((-carried.mass * GRAVITY, carried.com[0], carried.com[1]))
    return float_sum(force * lift_of(tree, joint, x, y) for force, x, y in forces)


def spring_rates(tree: JointTree, wheels: Sequence[Wheel]) -> list[float]:
    """Returns the vertical stiffness (N/m) of the springs above each wheel, or infinity."""
    rates = []
    for wheel in wheels:
        softness = float_sum(
            lift_of(tree, joint, *wheel.contact_point) ** 2 / joint.stiffness
            for joint in tree.joints_above(wheel.link)
            if joint.stiffness > 0.0
        )
        rates.append(1.0 / softness if softness > 0.0 else math.inf)
    return rates


# -- linear programs with a feasible origin, solved by the simplex method -----------------------
#
#     maximise c . x   subject to   A x <= b,  x >= 0,   with b >= 0.
#
# The origin is feasible, so that the method starts there and needs no first phase. Bland's rule
# chooses the pivots: the method ends for every input.

_ZERO = 1e-11


def maximize(
    objective: Sequence[float], rows: Sequence[Sequence[float]], bounds: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Return the solution x and the multiplier of each row.

    The multipliers y >= 0 satisfy A^T y >= c, with equality where x > 0, and y = 0 for a row that
    is not tight. The problem must be bounded; a direction without a bound is not followed.

    - ``objective``: c.
    - ``rows``, ``bounds``: A and b; negative elements of b count as 0.
    """
    n, m = len(objective), len(rows)
    table = [
        [*row, *(1.0 if i == k else 0.0 for k in range(m)), max(bound, 0.0)]
        for i, (row, bound) in enumerate(zip(rows, bounds, strict=True))
    ]
    costs = [*objective, *[0.0] * m, 0.0]
    basis = list(range(n, n + m))
    unbounded: set[int] = set()
    while True:
        entering = next(
            (j for j in range(n + m) if costs[j] > _ZERO and j not in unbounded),
            None,
        )
        if entering is None:
            break
        leaving, least = None, 0.0
        for i, row in enumerate(table):
            if row[entering] > _ZERO:
                ratio = row[-1] / row[entering]
                if leaving is None or (ratio, basis[i]) < (least, basis[leaving]):
                    leaving, least = i, ratio
        if leaving is None:
            unbounded.add(entering)
            continue
        pivot_row = [value / table[leaving][entering] for value in table[leaving]]
        table[leaving] = pivot_row
        for row in (*table[:leaving], *table[leaving + 1 :], costs):
            factor = row[entering]
            if factor != 0.0:
                for j, value in enumerate(pivot_row):
                    row[j] -= factor * value
        basis[leaving] = entering
    solution = [0.0] * (n + m)
    for i, j in enumerate(basis):
        solution[j] = table[i][-1]
    return solution[:n], [-cost for cost in costs[n : n + m]]
