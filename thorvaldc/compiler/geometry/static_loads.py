"""Static wheel loads, in N, and the rest positions of springs.

The wheels of a standing robot carry its weight W.  With contact points (x_i, y_i) and the centre
of mass at (x, y), the loads N_i satisfy

    sum N_i = W,   sum N_i x_i = W x,   sum N_i y_i = W y.

For more than three wheels these equations have many solutions.  Wheels of equal vertical
stiffness under a rigid body deflect in a plane, so N_i = a + b x_i + c y_i.  The same solution
has the least sum of squares of N_i.  A rocker adds one equation: its wheels balance about its
joint; then the solution of least squares is computed directly.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

from thorvaldc.compiler.geometry.wheel_geometry import UP, contact_point
from thorvaldc.model.robot import Joint, Wheel
from thorvaldc.model.spatial import Inertial, clean, dot
from thorvaldc.model.statics.gravity import GRAVITY
from thorvaldc.model.statics.joint_tree import JointTree


class Pivot(NamedTuple):
    """A joint without motor and spring, such as that of a rocker, which its wheels balance.

    ``levers`` (m): for each wheel of the robot, the moment about the joint per upward force of
    1 N at the wheel.  ``moment`` (N m): the moment of the weight that the joint carries; the
    wheel loads balance it.
    """

    levers: tuple[float, ...]
    moment: float


def free_pivots(tree: JointTree, wheels: Sequence[Wheel], actuated: Collection[str]) -> list[Pivot]:
    """Returns the pivots of a robot.

    Spin, steering and swivel joints of wheels are none.  ``actuated`` are the joints with motors.
    """
    pivots: list[Pivot] = []
    joints_of_wheels = {
        name for w in wheels for name in (w.spin_joint, w.steering_joint, w.swivel_joint) if name
    }
    for joint in tree.parent_joint.values():
        if joint.type not in ("revolute", "continuous") or joint.stiffness > 0.0:
            continue
        if joint.name in joints_of_wheels or joint.name in actuated or joint.mimic is not None:
            continue
        below = tree.links_below(joint.child)
        links = set(below)
        pose = tree.pose[joint.child]
        (ox, oy, _), (ax, ay, _) = pose.xyz, pose.rotate(joint.axis)

        def lever(x: float, y: float, line: tuple[float, ...] = (ox, oy, ax, ay)) -> float:
            # Moment of an upward unit force at (x, y) about the axis (ax, ay) through (ox, oy).
            return line[2] * (y - line[1]) - line[3] * (x - line[0])

        levers = [lever(*contact_point(w)) if w.link in links else 0.0 for w in wheels]
        if max(map(abs, levers), default=0.0) < 1e-6:
            continue
        carried = tree.inertial(below)
        moment = carried.mass * GRAVITY * lever(carried.com[0], carried.com[1])
        pivots.append(Pivot(tuple(levers), moment))
    return pivots


def static_loads(
    points: Sequence[tuple[float, float]], body: Inertial, pivots: Sequence[Pivot] = ()
) -> list[float]:
    """Returns the loads of the wheels in N.

    ``points`` are their contact points, ``body`` is the whole robot.  A wheel with a negative
    load would have to pull the robot down: its load is set to 0 and the others are computed
    again.  If all wheels are on one line, only the moment about the line's normal is balanced.
    """
    active = list(range(len(points)))
    weight = body.mass * GRAVITY
    loads = [0.0] * len(points)
    while active:
        if pivots:
            solution = _least_squares_loads(points, body, pivots, active)
        else:
            solution = _plane_loads([points[i] for i in active], body.com[:2], weight)
        lowest = min(range(len(active)), key=lambda k: solution[k])
        if solution[lowest] >= -1e-9 * max(weight, 1.0) or len(active) == 1:
            for i, load in zip(active, solution, strict=True):
                loads[i] = max(load, 0.0)
            break
        del active[lowest]
    return loads


def _least_squares_loads(
    points: Sequence[tuple[float, float]],
    body: Inertial,
    pivots: Sequence[Pivot],
    active: Sequence[int],
) -> list[float]:
    """Returns the loads of least squares that satisfy every balance ``row . loads = value``.

    Gram-Schmidt makes the rows orthonormal; a row that depends on the earlier ones is dropped.
    The solution of least squares is then the sum of the rows times their values.
    """
    weight = body.mass * GRAVITY
    balances = [
        ([1.0] * len(active), weight),
        ([points[i][0] for i in active], weight * body.com[0]),
        ([points[i][1] for i in active], weight * body.com[1]),
        *(([pivot.levers[i] for i in active], pivot.moment) for pivot in pivots),
    ]
    orthonormal: list[tuple[list[float], float]] = []
    for row, value in balances:
        length = math.sqrt(sum(a * a for a in row))
        for direction, share in orthonormal:
            projection = sum(a * b for a, b in zip(row, direction, strict=True))
            row = [a - projection * b for a, b in zip(row, direction, strict=True)]
            value -= projection * share
        remainder = math.sqrt(sum(a * a for a in row))
        if remainder > 1e-9 * length:
            orthonormal.append(([a / remainder for a in row], value / remainder))
    return [
        sum(share * direction[k] for direction, share in orthonormal) for k in range(len(active))
    ]


def _plane_loads(
    points: Sequence[tuple[float, float]], com: tuple[float, float], weight: float
) -> list[float]:
    """Returns N_i = W / n + b (x_i - mean x) + c (y_i - mean y), with the moments in balance."""
    n = len(points)
    mx, my = sum(p[0] for p in points) / n, sum(p[1] for p in points) / n
    sxx = sum((p[0] - mx) ** 2 for p in points)
    syy = sum((p[1] - my) ** 2 for p in points)
    sxy = sum((p[0] - mx) * (p[1] - my) for p in points)
    dx, dy = com[0] - mx, com[1] - my
    det = sxx * syy - sxy * sxy
    if det > 1e-9 * (sxx + syy) ** 2:
        b = weight * (syy * dx - sxy * dy) / det
        c = weight * (sxx * dy - sxy * dx) / det
    else:
        # All points are on one line: the wheels balance only the moment about its normal.
        trace = sxx + syy
        if trace == 0.0:
            return [weight / n] * n
        angle = 0.5 * math.atan2(2 * sxy, sxx - syy)
        ux, uy = math.cos(angle), math.sin(angle)
        slope = weight * (ux * dx + uy * dy) / trace
        b, c = slope * ux, slope * uy
    return [weight / n + b * (p[0] - mx) + c * (p[1] - my) for p in points]


def spring_reference(
    joint: Joint, tree: JointTree, wheels: Sequence[Wheel], loads: Sequence[float]
) -> float:
    """Returns the rest position of a spring (m or rad) whose joint is at 0 under the static load.

    The spring's force at 0 balances the force of the wheels minus the weight below the joint:
    stiffness * reference = -(wheel loads - weight below), along the axis.
    """
    below = set(tree.links_below(joint.child))
    wheel_force = sum(
        load for wheel, load in zip(wheels, loads, strict=True) if wheel.link in below
    )
    weight_below = tree.inertial(sorted(below)).mass * GRAVITY
    vertical = dot(tree.pose[joint.child].rotate(joint.axis), UP)
    return clean(-(wheel_force - weight_below) * vertical / joint.stiffness)
