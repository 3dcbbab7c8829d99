"""The space that a robot occupies: its solids, and the area that they cover, seen from above.

The solids of a link are its visible shapes, its collision shapes and the treads of its wheel.

The footprint contains the solids at all positions of the joints of the base: those that steer,
swivel, spring or roll. Joints of arms and tools stay at the position at which they start. A link is
carried from joint to joint down to ``base_link``. At a joint, its points become the points of the
swept space:

- a prismatic joint: the points at both limits. The hull of both contains the positions between.
- a joint that turns without limits: a cylinder about the joint axis, which contains the points.
- a joint that turns between limits: the points at the limits and at angles between them. A point at
  the distance r from the axis covers an arc. Between two angles that differ by 2 b, the arc is
  inside the tangents at both, which meet at the distance r / cos(b) from the axis.

Each solid is replaced by the prism that contains it: the convex hull, seen along the axis of the
first turning joint below it, or along the vertical, between the ends along this axis. If the axis
is vertical, or belongs to a rolling wheel, this does not enlarge the footprint.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from thorvaldc.model import (
    Box,
    Collision,
    Cylinder,
    Joint,
    MeshShape,
    Pose,
    Robot,
    Shape,
    Sphere,
    Vec3,
    Visual,
    Wheel,
)
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import Quat, add, clean3, quat_from_z_to, quat_to_matrix, scale
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.tip_over import Point, convex_hull
from thorvaldc.model.stl import mesh_vertices

FLANGE_THICKNESS = 0.004
"""Thickness (m) of the flanges of a tread."""
_ROLES = {"steering", "swivel", "suspension", "propulsion", "wheel"}
_SIDES = 16
"""Corners of the polygons around circles. The polygons contain the circles."""
_LARGEST_STEP = math.radians(15.0)
"""Largest angle between two positions of a turning joint."""
_SIMPLER = 0.005
"""Largest distance (m) between an edge that is left out and the corner in its place."""
_GRID = 0.001  # m


class Solid(NamedTuple):
    """A shape, its pose in the frame of its link, and the bytes of the mesh file of a mesh."""

    shape: Shape
    pose: Pose
    data: bytes = b""


@once_per_model
def solids_of(robot: Robot, with_visuals: bool = True) -> dict[str, list[Solid]]:
    """Return the solids of each link that is connected to the root link, each solid once.

    ``with_visuals``: false for the collision shapes and treads alone.
    """
    tree = tree_of(robot)
    data = {mesh.name: mesh.data for mesh in robot.meshes}
    solids: dict[str, dict[Solid, None]] = {}
    for link in robot.links:
        if link.name in tree.pose:
            shapes: tuple[Collision | Visual, ...] = link.collisions
            if with_visuals:
                shapes += link.visuals
            solids[link.name] = dict.fromkeys(
                Solid(part.shape, part.pose, data.get(getattr(part.shape, "mesh", ""), b""))
                for part in shapes
            )
    for wheel in robot.wheels:
        if wheel.treads:
            spin = tree.joints[wheel.spin_joint]
            axis = tree.pose[wheel.link].inverse().rotate(tree.pose[spin.child].rotate(spin.axis))
            solids[wheel.link] |= dict.fromkeys(_treads(wheel, quat_from_z_to(axis)))
    return {name: list(of_link) for name, of_link in solids.items()}


def _treads(wheel: Wheel, turned: Quat) -> Iterator[Solid]:
    for tread in wheel.treads:
        radius = wheel.radius_named(tread.name) + tread.flange
        width = tread.width + (2.0 * FLANGE_THICKNESS if tread.flange else 0.0)
        yield Solid(Cylinder(radius, width), Pose(tread.center, turned))


def corners_of(shape: Shape, pose: Pose, data: bytes = b"") -> list[Vec3]:
    """Return points whose convex hull contains a shape, in m.

    - ``pose``: pose of the shape in the frame of the points.
    - ``data``: bytes of the mesh file of a mesh. A mesh without bytes has no points.
    """
    points: list[Vec3]
    match shape:
        case Box((x, y, z)):
            points = [
                (a * x, b * y, c * z) for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (-0.5, 0.5)
            ]
        case Cylinder(radius, length):
            points = [(x, y, c * length) for x, y in circle_around(radius) for c in (-0.5, 0.5)]
        case Sphere(radius):
            circle = list(circle_around(radius))
            points = [(x, y, 0.0) for x, y in circle]
            points += [(x, 0.0, z) for x, z in circle] + [(0.0, y, z) for y, z in circle]
        case MeshShape(mesh, (sx, sy, sz)):
            points = [(x * sx, y * sy, z * sz) for x, y, z in mesh_vertices(mesh, data)]
    (a, b, c), (d, e, f), (g, h, i) = quat_to_matrix(pose.quat)
    px, py, pz = pose.xyz
    return [
        (a * x + b * y + c * z + px, d * x + e * y + f * z + py, g * x + h * y + i * z + pz)
        for x, y, z in points
    ]


def circle_around(radius: float) -> Iterator[Point]:
    """Yield the corners of a polygon around a circle about the origin, counter-clockwise, in m."""
    outer = radius / math.cos(math.pi / _SIDES)
    for k in range(_SIDES):
        angle = 2.0 * math.pi * (k + 0.5) / _SIDES
        yield outer * math.cos(angle), outer * math.sin(angle)


@once_per_model
def footprint(robot: Robot) -> list[Point]:
    """Return the corners of the footprint in ``base_link`` in m, counter-clockwise.

    The footprint is the convex area that the robot covers, with the joints of its base at any
    position. Coordinates are rounded away from the origin to millimetres.
    """
    tree = tree_of(robot)
    starts = {servo.joint: servo.initial for servo in robot.joint_servos}
    placed = tree.at(starts) if starts else tree
    root = placed.order[0]
    # The first link of each body that moves as a whole, the axis of its prisms, and their corners.
    first, axis, points = {root: root}, {root: (0.0, 0.0, 1.0)}, {root: list[Vec3]()}
    for name in placed.order:
        if name != root:
            joint = placed.parent_joint[name]
            first[name] = body = name if _moves(joint) else first[joint.parent]
            if body == name:
                points[name] = []
                above = placed.pose[name].inverse() * placed.pose[first[joint.parent]]
                inherited = clean3(above.rotate(axis[first[joint.parent]]))
                axis[name] = inherited if joint.type == "prismatic" else joint.axis
        body = first[name]
        in_body = placed.pose[body].inverse() * placed.pose[name]
        along = clean3(in_body.inverse().rotate(axis[body]))
        for solid in solids_of(robot)[name]:
            points[body] += map(in_body.apply, _prism(solid, along))
    for name in reversed(points):  # each body before the one that carries it
        if name != root and points[name]:
            joint = placed.parent_joint[name]
            body = first[joint.parent]
            swept = _swept(joint, axis[name], points[name])
            points[body] += map((placed.pose[body].inverse() * placed.pose[name]).apply, swept)
    hull = _without_short_edges(convex_hull([(x, y) for x, y, _ in points[root]]))
    return convex_hull([(_outward(x), _outward(y)) for x, y in hull])


def _without_short_edges(hull: list[Point]) -> list[Point]:
    """Return a polygon of fewer corners that contains a convex polygon and is nearly as small.

    Navigation tests each edge of a footprint at each step. Without an edge, the edges beside it
    continue to where they meet.
    """
    corners = list(hull)
    while len(corners) > 4:
        shortest: tuple[float, int, Point] | None = None
        for k, (bx, by) in enumerate(corners):
            (ax, ay), (cx, cy) = corners[k - 1], corners[(k + 1) % len(corners)]
            dx, dy = corners[(k + 2) % len(corners)]
            length = math.hypot(cx - bx, cy - by)
            # The meeting point b + t (b - a) of the lines a b and d c.
            turn = (bx - ax) * (cy - dy) - (by - ay) * (cx - dx)
            if turn >= 0.0:
                continue  # they do not meet outside
            t = ((cx - bx) * (cy - dy) - (cy - by) * (cx - dx)) / turn
            x, y = bx + t * (bx - ax), by + t * (by - ay)
            distance = ((x - bx) * (cy - by) - (y - by) * (cx - bx)) / length
            if distance <= _SIMPLER and (shortest is None or distance < shortest[0]):
                shortest = distance, k, (x, y)
        if shortest is None:
            break
        _, k, meeting = shortest
        corners[k] = meeting
        del corners[(k + 1) % len(corners)]
    return corners


def _moves(joint: Joint) -> bool:
    return joint.role in _ROLES and joint.type != "fixed"


def _outward(value: float) -> float:
    # A tolerance of 1 nm keeps 0.55 from becoming 0.551.
    steps = math.ceil(abs(value) / _GRID - 1e-6)
    return math.copysign(steps / round(1 / _GRID), value) if steps else 0.0


@functools.lru_cache(maxsize=1024)
def _prism(solid: Solid, axis: Vec3) -> tuple[Vec3, ...]:
    """Return the corners of a prism along an axis that contains a solid, in the frame of its link.

    Equal modules have equal prisms.
    """
    along = Pose(quat=quat_from_z_to(axis))
    return tuple(
        map(
            along.apply,
            _prism_around(corners_of(solid.shape, along.inverse() * solid.pose, solid.data)),
        )
    )


def _prism_around(points: Sequence[Vec3]) -> list[Vec3]:
    """Return the corners of the prism along z that contains points."""
    if not points:
        return []
    heights = [z for _, _, z in points]
    ends = min(heights), max(heights)
    return [(x, y, z) for x, y in convex_hull([(x, y) for x, y, _ in points]) for z in ends]


def _swept(joint: Joint, axis: Vec3, points: Sequence[Vec3]) -> list[Vec3]:
    """Return the corners of a prism that contains points at all positions of a joint.

    The points are in the frame of the child link, which is on the joint axis.  ``axis``: direction
    of the prism, that of the joint if it turns.
    """
    along = Pose(quat=quat_from_z_to(axis))
    lower, upper = joint.lower, joint.upper
    if joint.type == "prismatic":
        ends = [scale(s, joint.axis) for s in (lower or 0.0, upper or 0.0)]
        points = [add(point, end) for point in points for end in ends]
    prism = _prism_around(list(map(along.inverse().apply, points)))
    if joint.type == "prismatic":
        return list(map(along.apply, prism))
    if lower is None or upper is None or upper - lower >= 2.0 * math.pi:
        radius = max(math.hypot(x, y) for x, y, _ in prism)
        swept = [(x, y, z) for x, y in circle_around(radius) for z in {z for _, _, z in prism}]
        return list(map(along.apply, swept))
    steps = math.ceil((upper - lower) / _LARGEST_STEP) or 1
    step = (upper - lower) / steps
    stretch = 1.0 / math.cos(step / 2)
    turns = [(lower, 1.0), (upper, 1.0)]
    turns += [(lower + (k + 0.5) * step, stretch) for k in range(steps)]
    swept = []
    for angle, factor in turns:
        c, s = factor * math.cos(angle), factor * math.sin(angle)
        swept += [(c * x - s * y, s * x + c * y, z) for x, y, z in prism]
    return list(map(along.apply, _prism_around(swept)))
