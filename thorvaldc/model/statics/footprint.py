"""The footprint of a robot: the convex area that it covers, seen from above."""

from __future__ import annotations

import math
from collections.abc import Iterator

from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Box, Cylinder, MeshShape, Robot, Shape, Sphere
from thorvaldc.model.spatial import Vec3
from thorvaldc.model.statics.convex_hull import Point, convex_hull
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.mesh_vertices import mesh_vertices

_SIDES = 16
"""Corners of the polygons around circles. The polygons contain the circles."""
_GRID = 0.001  # m


@once_per_model
def footprint(robot: Robot) -> list[Point]:
    """Return the corners of the footprint in ``base_link`` in m, counter-clockwise.

    The footprint is the convex hull of the collision shapes of all links, with every joint at
    position 0, and of the circles that the wheels cover when they steer or swivel. Coordinates are
    rounded away from the origin to millimetres.
    """
    tree = tree_of(robot)
    meshes = {mesh.name: mesh.data for mesh in robot.meshes}
    points: list[Point] = []
    for link in robot.links:
        pose = tree.pose.get(link.name)
        if pose is None:
            continue
        for collision in link.collisions:
            place = pose * collision.pose
            for corner in _corners(collision.shape, meshes):
                x, y, _ = place.apply(corner)
                points.append((x, y))
    for wheel in robot.wheels:
        # A wheel that turns covers a circle around its axis; others cover a part of the circle.
        reach = math.hypot(wheel.radius + abs(wheel.trail), wheel.width / 2)
        reach += abs(wheel.lateral_offset)
        if wheel.steered or wheel.swivel_joint is not None:
            points += [(wheel.x + x, wheel.y + y) for x, y in _circle(reach)]
    return convex_hull([(_outward(x), _outward(y)) for x, y in convex_hull(points)])


def _outward(value: float) -> float:
    # A tolerance of 1 nm keeps 0.55 from becoming 0.551.
    steps = math.ceil(abs(value) / _GRID - 1e-6)
    return math.copysign(steps / round(1 / _GRID), value) if steps else 0.0


def _circle(radius: float) -> Iterator[Point]:
    outer = radius / math.cos(math.pi / _SIDES)
    for k in range(_SIDES):
        angle = 2.0 * math.pi * (k + 0.5) / _SIDES
        yield outer * math.cos(angle), outer * math.sin(angle)


def _corners(shape: Shape, meshes: dict[str, bytes]) -> Iterator[Vec3]:
    """Yield points whose convex hull contains a shape, in the frame of the shape."""
    match shape:
        case Box((x, y, z)):
            for k in range(8):
                yield tuple(  # type: ignore[misc]
                    size / 2 if k >> axis & 1 else -size / 2 for axis, size in enumerate((x, y, z))
                )
        case Cylinder(radius, length):
            for x, y in _circle(radius):
                yield x, y, length / 2
                yield x, y, -length / 2
        case Sphere(radius):
            for x, y in _circle(radius):
                yield x, y, 0.0
                yield x, 0.0, y
                yield 0.0, x, y
        case MeshShape(mesh, (sx, sy, sz)):
            for x, y, z in mesh_vertices(mesh, meshes[mesh]):
                yield x * sx, y * sy, z * sz
