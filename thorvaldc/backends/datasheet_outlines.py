"""Outlines of a robot's shapes in parallel projection, for drawings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from thorvaldc.model import Box, Collision, Cylinder, MeshShape, Robot, Shape, Sphere, Vec3, Visual
from thorvaldc.model.spatial import Quat, cross, dot, rotate
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.tip_over import Point, convex_hull
from thorvaldc.model.stl import mesh_vertices

_SIDES = 24
"""Corners of the polygons for circles."""
_GRID = 1e-4
"""Points of an outline are rounded to this length in m, because the outline of a mesh with many
vertices has thousands of them."""


class View(NamedTuple):
    """A direction of view. ``right`` and ``up`` are the axes of the picture in ``base_link``."""

    name: str
    right: Vec3
    up: Vec3

    @property
    def towards(self) -> Vec3:
        """The unit vector from the robot to the viewer."""
        return cross(self.right, self.up)


TOP = View("top", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
FRONT = View("front", (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
REAR = View("rear", (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
RIGHT = View("right side", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
LEFT = View("left side", (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


class Outline(NamedTuple):
    """The outline of a shape in a view.

    - ``points``: corners of a convex polygon in m, to the right and up.
    - ``depth``: distance of its middle towards the viewer in m.
    - ``color``: red, green, blue and opacity of the shape.
    """

    points: tuple[Point, ...]
    depth: float
    color: tuple[float, float, float, float]


class OutlineProjector:
    """Projects the visible shapes of one robot with all joints at position 0.

    The outline of a mesh is that of its convex hull. A link without visible shapes is drawn with
    its collision shapes. Equal meshes with equal orientations are projected once.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._pose = tree_of(robot).pose
        self._data = {mesh.name: mesh.data for mesh in robot.meshes}
        self._known: dict[tuple[Shape, Quat, View], tuple[list[Point], float]] = {}

    def outlines(self, view: View) -> list[Outline]:
        """Return the outlines of all shapes in a view, from the back to the front."""
        towards = view.towards
        outlines = []
        for link in self._robot.links:
            pose = self._pose.get(link.name)
            parts: tuple[Visual | Collision, ...] = link.visuals or link.collisions
            for part in parts if pose is not None else ():
                place = self._pose[link.name] * part.pose
                w, x, y, z = (round(value, 12) for value in place.quat)
                hull, depth = self._outline(part.shape, (w, x, y, z), view)
                if not hull:
                    continue
                right, up = dot(view.right, place.xyz), dot(view.up, place.xyz)
                outlines.append(
                    Outline(
                        tuple((right + u, up + v) for u, v in hull),
                        depth + dot(towards, place.xyz),
                        part.color if isinstance(part, Visual) else (0.6, 0.6, 0.6, 1.0),
                    )
                )
        return sorted(outlines, key=lambda outline: round(outline.depth, 9))

    def _outline(self, shape: Shape, quat: Quat, view: View) -> tuple[list[Point], float]:
        """Return the outline of a shape relative to its origin, and the depth of its middle."""
        key = shape, quat, view
        if key not in self._known:
            towards = view.towards
            corners = [rotate(quat, corner) for corner in self._corners(shape)]
            depths = [dot(towards, corner) for corner in corners]
            self._known[key] = (
                convex_hull(_projected(corners, view)),
                (min(depths) + max(depths)) / 2 if depths else 0.0,
            )
        return self._known[key]

    def _corners(self, shape: Shape) -> Iterable[Vec3]:
        match shape:
            case Box(size=(x, y, z)):
                return [
                    (a * x / 2, b * y / 2, c * z / 2)
                    for a in (-1, 1)
                    for b in (-1, 1)
                    for c in (-1, 1)
                ]
            case Cylinder(radius=radius, length=length):
                return [(x, y, c * length / 2) for x, y in _circle(radius) for c in (-1, 1)]
            case Sphere(radius=radius):
                circles = [
                    (radius * math.cos(a), radius * math.sin(a))
                    for a in (math.pi * k / 12 for k in range(-6, 7))
                ]
                return [(x, y, z) for r, z in circles for x, y in _circle(max(r, 0.0))]
            case MeshShape(mesh=mesh, scale=(sx, sy, sz)):
                vertices = mesh_vertices(mesh, self._data.get(mesh, b""))
                return [(x * sx, y * sy, z * sz) for x, y, z in vertices]


def _circle(radius: float) -> Iterator[Point]:
    for k in range(_SIDES):
        angle = math.tau * (k + 0.5) / _SIDES
        yield radius * math.cos(angle), radius * math.sin(angle)


def _projected(corners: Iterable[Vec3], view: View) -> list[Point]:
    points = {
        (round(dot(view.right, corner) / _GRID), round(dot(view.up, corner) / _GRID)): None
        for corner in corners
    }
    return [(u * _GRID, v * _GRID) for u, v in points]
