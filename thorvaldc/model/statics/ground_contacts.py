"""Parts on the ground other than the wheels of the base, such as the wheels of a trailer.

They carry a part of the weight. For the statics, each is a wheel without a motor whose contact
point is the middle of the surface with which it stands on the ground. The base calculator, the
driver and the targets do not know these wheels.

Wheels behind a hinge, such as the pitch of a drawbar, carry the trailer but do not hold the base
(``held_body``). Parts behind a slide, and parts whose hinges let them fall, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.model import Joint, Link, Mesh, Robot, Vec3, Wheel
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import GRAVITY, clean
from thorvaldc.model.statics.convex_bodies import ConvexBody
from thorvaldc.model.statics.joint_tree import (
    SHORTEST_LEVER,
    JointTree,
    held_joints,
    hinges,
    lift_of,
    tree_of,
)
from thorvaldc.model.statics.standing import find_standing
from thorvaldc.model.statics.static_loads import static_loads
from thorvaldc.model.sums import float_sum

ON_GROUND = 2e-3
"""Largest height (m) of a part that stands on the ground, as of the wheels of the base."""
_TILT = 1e-4
"""Tilt of the four directions downwards, whose furthest points are around a flat surface."""


def ground_contacts(
    tree: JointTree, wheels: Sequence[Wheel], meshes: Sequence[Mesh], stopped: Collection[str]
) -> tuple[Wheel, ...]:
    """Return a wheel for each part that carries load, in the order of the links.

    - ``wheels``: those of the base, whose links are left out.
    - ``stopped``: names of the joints that motors and servos hold.
    """
    contacts = tuple(
        replace(
            wheels[0],
            name=name,
            module=tree.links[name].module,
            link=name,
            spin_joint=tree.parent_joint[name].name,
            steering_joint=None,
            swivel_joint=None,
            suspension_joint=None,
            driven=False,
            x=point[0],
            y=point[1],
            trail=0.0,
            lateral_offset=0.0,
            radius=point[2],
            radii=(),
            load=0.0,
            contact_height=0.0,
            span=tree.links[name].span,
            treads=(),
            rolling_resistance=wheels[0].rolling_resistance
            if tree.parent_joint[name].type == "continuous"
            else wheels[0].friction,  # it slides
        )
        for name, points in standing_links(tree, wheels, meshes).items()
        if all(joint.type != "prismatic" for joint in tree.joints_above(name))
        for point in points
    )
    if any(hinges(tree, contact.link, stopped) for contact in contacts):
        standing = find_standing(tree, [*wheels, *contacts], stopped, sprung=True)
        if standing is not None and not standing.stands:
            return tuple(c for c in contacts if not hinges(tree, c.link, stopped))
    return contacts


def standing_links(
    tree: JointTree, wheels: Sequence[Wheel], meshes: Sequence[Mesh]
) -> dict[str, list[Vec3]]:
    """Return the links that stand on the ground beside the wheels, with their contact points.

    A contact point has its x and y, and as z the height of the body above it, in m.
    """
    if not wheels:
        return {}
    rolling = {wheel.link for wheel in wheels}
    data = {mesh.name: mesh.data for mesh in meshes}
    standing = {
        name: list(_contacts(tree.links[name], tree, data))
        for name in tree.order[1:]
        if name not in rolling
    }
    return {name: points for name, points in standing.items() if points}


def _contacts(link: Link, tree: JointTree, data: dict[str, bytes]) -> Iterator[Vec3]:
    for collision in link.collisions:
        mesh = data.get(getattr(collision.shape, "mesh", ""), b"")
        body = ConvexBody(collision.shape, tree.pose[link.name] * collision.pose, mesh)
        height = body.center[2]
        if height - body.reach > ON_GROUND:
            continue
        z = -math.sqrt(1.0 - 2.0 * _TILT * _TILT)
        points = [body.furthest((a * _TILT, b * _TILT, z)) for a in (-1, 1) for b in (-1, 1)]
        if abs(min(z for *_, z in points)) <= ON_GROUND and height > 0.0:
            yield (
                float_sum(x for x, *_ in points) / 4,
                float_sum(y for _, y, _ in points) / 4,
                height,
            )


@once_per_model
def _with_contacts(robot: Robot) -> Robot | None:
    tree, stopped = tree_of(robot), held_joints(robot)
    contacts = ground_contacts(tree, robot.wheels, robot.meshes, stopped)
    if not contacts:
        return None
    wheels = (*robot.wheels, *contacts)
    standing = find_standing(tree, wheels, stopped, sprung=True)
    points = [wheel.contact_point for wheel in wheels]
    loads = standing.loads if standing is not None else static_loads(points, robot.inertial)
    carried = zip(contacts, loads[len(robot.wheels) :], strict=True)
    return replace(robot, wheels=(*robot.wheels, *(replace(w, load=clean(n)) for w, n in carried)))


def with_ground_contacts(robot: Robot) -> Robot:
    """Return the robot with a wheel for each other part on the ground, after its own wheels, with
    the load that it carries."""
    return _with_contacts(robot) or robot


class HeldBody(NamedTuple):
    """What can tip over: the base with its share of the trailers.

    - ``supports``: points (m, in ``base_link``) on which it stands: the contact points, and the
      point below the axis of a pendulum axle.
    - ``com``: the centre of mass (m, in ``base_link``) of what they carry. The load that the wheels
      of a trailer do not carry acts at its hinge.
    - ``along``: height (m) at which forces along x act. A trailer rolls freely, so that all of its
      mass pushes and pulls at its hinge.
    """

    supports: tuple[tuple[float, float], ...]
    com: Vec3
    along: float


@once_per_model
def held_body(robot: Robot) -> HeldBody:
    """Return what can tip over, with all joints at position 0."""
    tree, stopped, body = tree_of(robot), held_joints(robot), robot.inertial
    supports: list[tuple[float, float]] = []
    trailing: dict[Wheel, Joint] = {}
    hinged: dict[tuple[Joint, ...], list[Wheel]] = {}
    for wheel in with_ground_contacts(robot).wheels:
        hinged.setdefault(tuple(hinges(tree, wheel.link, stopped)), []).append(wheel)
    for joints, wheels in hinged.items():
        pivot = _pivot(tree, joints, wheels)
        if not joints:
            supports += [wheel.contact_point for wheel in wheels]
        elif pivot is not None:
            supports.append(pivot)
        else:
            trailing.update(dict.fromkeys(wheels, joints[-1]))
    left = body.mass - float_sum(wheel.load for wheel in trailing) / GRAVITY
    if not trailing or left <= 0.0:
        return HeldBody(tuple(supports), body.com, body.com[2])
    x, y = (
        body.mass * body.com[k] - float_sum(w.load / GRAVITY * w.contact_point[k] for w in trailing)
        for k in (0, 1)
    )
    heights = {
        link: tree.pose[joint.child].xyz[2]
        for joint in trailing.values()
        for link in tree.links_below(joint.child)
    }
    along = float_sum(
        link.inertial.mass * heights.get(name, tree.pose[name].apply(link.inertial.com)[2])
        for name, link in tree.links.items()
        if link.inertial is not None and name in tree.pose
    )
    across = along - float_sum(wheel.load / GRAVITY * heights[wheel.link] for wheel in trailing)
    return HeldBody(tuple(supports), (x / left, y / left, across / left), along / left)


def _pivot(
    tree: JointTree, joints: Sequence[Joint], wheels: Sequence[Wheel]
) -> tuple[float, float] | None:
    """Returns the point below the axis of the only hinge at which one or two wheels carry the base;
    ``None`` for the wheels of a trailer."""
    if len(joints) != 1 or len(wheels) > 2:
        return None
    first, second = wheels[0], wheels[-1]
    a, b = (lift_of(tree, joints[0], *w.contact_point) for w in (first, second))
    if max(abs(a), abs(b)) <= SHORTEST_LEVER:
        share = 0.5
    elif a * b < 0.0:
        share = a / (a - b)
    else:
        return None
    (ax, ay), (bx, by) = first.contact_point, second.contact_point
    return ax + share * (bx - ax), ay + share * (by - ay)
