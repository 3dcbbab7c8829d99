"""Parts on the ground other than the wheels of the base, such as the wheels of a trailer.

They carry a part of the weight. For the statics, each is a wheel without a motor whose contact
point is the middle of the surface with which it stands on the ground. The base calculator, the
driver and the targets do not know these wheels.

Parts behind a joint that gives way, such as the pitch of a drawbar or a limp slide, do not hold the
base, so they are left out. A joint with a vertical axis that turns carries vertical forces as a
fixed one does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from thorvaldc.model import Link, Mesh, Robot, Vec3, Wheel
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.convex_bodies import ConvexBody
from thorvaldc.model.statics.joint_tree import JointTree, held_joints, tree_of
from thorvaldc.model.statics.standing import find_standing
from thorvaldc.model.statics.static_loads import static_loads
from thorvaldc.model.sums import float_sum

ON_GROUND = 2e-3
"""Largest height (m) of a part that stands on the ground, as of the wheels of the base."""
_VERTICAL = 0.99
"""Least cosine of the angle between a joint axis and the vertical."""
_TILT = 1e-4
"""Tilt of the four directions downwards, whose furthest points are around a flat surface."""


def ground_contacts(
    tree: JointTree, wheels: Sequence[Wheel], meshes: Sequence[Mesh]
) -> tuple[Wheel, ...]:
    """Return a wheel for each part on the ground that holds the base, in the order of the links.

    ``wheels``: those of the base, whose links are left out.
    """
    return tuple(
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
        if _holds(name, tree)
        for point in points
    )


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


def _holds(link: str, tree: JointTree) -> bool:
    """Returns whether all joints above a link, without that about which it rolls, are stiff."""
    moving = [joint for joint in tree.joints_above(link) if joint.type != "fixed"]
    if moving and moving[0].type == "continuous":
        del moving[0]
    return all(
        joint.type != "prismatic" and abs(tree.pose[joint.child].rotate(joint.axis)[2]) > _VERTICAL
        for joint in moving
    )


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
    tree = tree_of(robot)
    contacts = ground_contacts(tree, robot.wheels, robot.meshes)
    if not contacts:
        return None
    wheels = (*robot.wheels, *contacts)
    standing = find_standing(tree, wheels, held_joints(robot), sprung=True)
    points = [wheel.contact_point for wheel in wheels]
    loads = standing.loads if standing is not None else static_loads(points, robot.inertial)
    carried = zip(contacts, loads[len(robot.wheels) :], strict=True)
    return replace(robot, wheels=(*robot.wheels, *(replace(w, load=clean(n)) for w, n in carried)))


def with_ground_contacts(robot: Robot) -> Robot:
    """Return the robot with a wheel for each other part on the ground, after its own wheels, with
    the load that it carries."""
    return _with_contacts(robot) or robot
