"""The base of the robot: forward kinematics at zero, wheels, ground and static loads."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from thorvaldc.compiler.modules.hardware import WheelPart
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model.robot import Actuator, Joint, Wheel
from thorvaldc.model.spatial import (
    Inertial,
    Vec3,
    add,
    clean,
    cross,
    dot,
    norm,
    scale,
)
from thorvaldc.model.statics.gravity import GRAVITY
from thorvaldc.model.statics.joint_tree import JointTree

UP: Vec3 = (0.0, 0.0, 1.0)


class PlacedWheel(NamedTuple):
    """A module's wheel in the robot, before its geometry is known."""

    name: str
    module: str
    link: str
    part: WheelPart
    span: Span


def lowest_point(center: Vec3, axis: Vec3, radius: float) -> Vec3:
    """The lowest point of a wheel: of the circle in its middle plane, also under camber.

    Where the wheel leans on the ground it rolls on ``radius``, as in every output.
    """
    level = math.sqrt(max(1.0 - axis[2] * axis[2], 1e-12))
    down: Vec3 = (axis[0] * axis[2], axis[1] * axis[2], axis[2] * axis[2] - 1.0)
    return add(center, scale(radius / level, down))


class _Chain(NamedTuple):
    spin: Joint
    steering: Joint | None
    swivel: Joint | None
    suspension: Joint | None
    axis: Vec3


def _chain(tree: JointTree, wheel: PlacedWheel, report: Report) -> _Chain | None:
    above = tree.joints_above(wheel.link)
    moving = [j for j in above if j.type != "fixed"]
    if not moving or moving[0].type not in ("continuous", "revolute"):
        report.add(
            "wheel-does-not-spin",
            f"the wheel of `{wheel.module}` hangs on no joint that turns it",
            wheel.span,
            hint="mount it on a drive or a caster",
        )
        return None
    spin = moving[0]
    axis = tree.pose[spin.child].rotate(spin.axis)
    steering = swivel = suspension = None
    for joint in moving[1:]:
        if joint.role == "steering" and steering is None and swivel is None:
            steering = joint
        elif joint.role == "swivel" and swivel is None and steering is None:
            swivel = joint
        elif joint.role == "suspension" and suspension is None:
            suspension = joint
    return _Chain(spin, steering, swivel, suspension, axis)


def ground_height(tree: JointTree, wheels: Sequence[PlacedWheel], report: Report) -> float:
    """How far ``base_link`` must be lifted so that the lowest wheel stands on z = 0."""
    heights = []
    for wheel in wheels:
        chain = _chain(tree, wheel, report)
        if chain is not None:
            point = lowest_point(tree.pose[wheel.link].xyz, chain.axis, wheel.part.radius)
            heights.append(point[2])
    return -min(heights) if heights else 0.0


def make_wheels(
    tree: JointTree,
    placed: Sequence[PlacedWheel],
    actuators: Mapping[str, Actuator],
    report: Report,
) -> list[Wheel]:
    """The wheels' geometry in ``base_link``; loads are filled in later."""
    wheels: list[Wheel] = []
    for item in placed:
        chain = _chain(tree, item, report)
        if chain is None:
            continue
        part = item.part
        forward = cross(chain.axis, UP)
        if norm(forward) < 0.17:  # within 10 degrees of lying flat
            report.add(
                "wheel-lies-flat",
                f"the wheel of `{item.module}` spins about a vertical axis",
                item.span,
                hint="turn its mount",
            )
            continue
        heading = math.atan2(forward[1], forward[0])
        point = lowest_point(tree.pose[item.link].xyz, chain.axis, part.radius)
        x, y, sign = point[0], point[1], 1.0
        turning = chain.steering or chain.swivel
        trail = lateral = 0.0
        if turning is not None:
            frame = tree.pose[turning.child]
            direction = frame.rotate(turning.axis)
            if abs(direction[2]) < 0.5:
                tilt = math.degrees(math.acos(min(1.0, abs(direction[2]))))
                report.add(
                    "steering-axis-tilted",
                    f"the steering axis of `{item.module}` is {tilt:.0f} deg off the vertical",
                    item.span,
                    hint="the base calculators need a nearly vertical axis",
                )
                continue
            sign = 1.0 if direction[2] > 0 else -1.0
            t = (point[2] - frame.xyz[2]) / direction[2]
            x, y = frame.xyz[0] + t * direction[0], frame.xyz[1] + t * direction[1]
            c, s = math.cos(heading), math.sin(heading)
            trail = c * (point[0] - x) + s * (point[1] - y)
            lateral = -s * (point[0] - x) + c * (point[1] - y)
        wheels.append(
            Wheel(
                name=item.name,
                module=item.module,
                link=item.link,
                spin_joint=chain.spin.name,
                steering_joint=chain.steering.name if chain.steering else None,
                swivel_joint=chain.swivel.name if chain.swivel else None,
                suspension_joint=chain.suspension.name if chain.suspension else None,
                driven=chain.spin.name in actuators,
                x=clean(x),
                y=clean(y),
                heading=clean(heading),
                steering_sign=sign,
                trail=clean(round(trail, 10)),
                lateral_offset=clean(round(lateral, 10)),
                radius=part.radius,
                width=part.width,
                radii=part.radii,
                friction=part.friction,
                rolling_resistance=part.rolling_resistance,
                load=0.0,
                contact_height=clean(round(point[2], 9)),
                span=item.span,
                treads=part.treads,
            )
        )
    return wheels


def contact_point(wheel: Wheel) -> tuple[float, float]:
    """Where the wheel stands in ``base_link``, every joint at zero, m."""
    c, s = math.cos(wheel.heading), math.sin(wheel.heading)
    return (
        wheel.x + c * wheel.trail - s * wheel.lateral_offset,
        wheel.y + s * wheel.trail + c * wheel.lateral_offset,
    )


class Pivot(NamedTuple):
    """A joint that turns freely, such as that of a rocker: nothing holds it but its wheels.

    ``levers`` (m) has for each wheel of the robot the moment about the joint of an upward
    force of 1 N under it; ``moment`` (N m) is that with which they are in balance.
    """

    levers: tuple[float, ...]
    moment: float


def free_pivots(tree: JointTree, wheels: Sequence[Wheel], actuated: Collection[str]) -> list[Pivot]:
    """The joints without spring and motor that wheels hang on, but for their own axles."""
    found: list[Pivot] = []
    own = {
        name for w in wheels for name in (w.spin_joint, w.steering_joint, w.swivel_joint) if name
    }
    for joint in tree.parent_joint.values():
        if joint.type not in ("revolute", "continuous") or joint.stiffness > 0.0:
            continue
        if joint.name in own or joint.name in actuated or joint.mimic is not None:
            continue
        below = tree.links_below(joint.child)
        links = set(below)
        pose = tree.pose[joint.child]
        (ox, oy, _), (ax, ay, _) = pose.xyz, pose.rotate(joint.axis)

        def lever(x: float, y: float, at: tuple[float, ...] = (ox, oy, ax, ay)) -> float:
            return at[2] * (y - at[1]) - at[3] * (x - at[0])

        levers = [lever(*contact_point(w)) if w.link in links else 0.0 for w in wheels]
        if max(map(abs, levers), default=0.0) < 1e-6:
            continue
        carried = tree.inertial(below)
        moment = carried.mass * GRAVITY * lever(carried.com[0], carried.com[1])
        found.append(Pivot(tuple(levers), moment))
    return found


def static_loads(
    points: Sequence[tuple[float, float]], body: Inertial, pivots: Sequence[Pivot] = ()
) -> list[float]:
    """The wheels' shares of the weight in N, for equal stiffness under each.

    N_i = a + b x_i + c y_i with the sum and both moments in balance; with pivots, the least
    forces (sum of squares) for which they are in balance as well.  A wheel
    that would have to pull carries nothing and the rest is solved again.
    Wheels on one line carry what the line can carry.
    """
    active = list(range(len(points)))
    weight = body.mass * GRAVITY
    loads = [0.0] * len(points)
    while active:
        if pivots:
            found = _balanced(points, body, pivots, active)
        else:
            found = _plane([points[i] for i in active], (body.com[0], body.com[1]), weight)
        worst = min(range(len(active)), key=lambda k: found[k])
        if found[worst] >= -1e-9 * max(weight, 1.0) or len(active) == 1:
            for i, load in zip(active, found, strict=True):
                loads[i] = max(load, 0.0)
            break
        del active[worst]
    return loads


def _balanced(
    points: Sequence[tuple[float, float]],
    body: Inertial,
    pivots: Sequence[Pivot],
    active: Sequence[int],
) -> list[float]:
    """The forces of least squares that satisfy each balance, one orthogonal part after another."""
    weight = body.mass * GRAVITY
    balances = [
        ([1.0] * len(active), weight),
        ([points[i][0] for i in active], weight * body.com[0]),
        ([points[i][1] for i in active], weight * body.com[1]),
        *(([pivot.levers[i] for i in active], pivot.moment) for pivot in pivots),
    ]
    parts: list[tuple[list[float], float]] = []
    for row, value in balances:
        size = math.sqrt(sum(a * a for a in row))
        for direction, share in parts:
            along = sum(a * b for a, b in zip(row, direction, strict=True))
            row = [a - along * b for a, b in zip(row, direction, strict=True)]
            value -= along * share
        rest = math.sqrt(sum(a * a for a in row))
        if rest > 1e-9 * size:
            parts.append(([a / rest for a in row], value / rest))
    return [sum(share * direction[k] for direction, share in parts) for k in range(len(active))]


def _plane(
    points: Sequence[tuple[float, float]], com: tuple[float, float], weight: float
) -> list[float]:
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
        # All on one line: only the moment about its normal can be carried.
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
    """The rest position of a spring whose joint stands at zero under the static load.

    In balance: stiffness * reference = -(wheel loads - weight below) along the axis.
    """
    below = set(tree.links_below(joint.child))
    carried = sum(load for wheel, load in zip(wheels, loads, strict=True) if wheel.link in below)
    unsprung = tree.inertial(sorted(below)).mass * GRAVITY
    along = dot(tree.pose[joint.child].rotate(joint.axis), UP)
    return clean(-(carried - unsprung) * along / joint.stiffness)
