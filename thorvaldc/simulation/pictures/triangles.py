"""Triangles of the visual shapes of a robot, and the text on a zone.

The module needs neither numpy nor trimesh: the playground draws robots in a browser without them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from itertools import chain
from typing import NamedTuple

from thorvaldc.compiler.shapes.mesh_formats import obj_triangles
from thorvaldc.model import Box, Cylinder, MeshShape, Robot, Shape, Sphere, Vec3, Zone
from thorvaldc.model.stl import stl_triangles

SIDES = 24
"""Number of corners of a circle."""


class Surface(NamedTuple):
    """The surface of a shape.

    - ``points``: vertices (m) in the frame of the shape.
    - ``triangles``: indices of the three vertices of each triangle, counter-clockwise from outside.
    """

    points: list[Vec3]
    triangles: list[tuple[int, int, int]]


def surface(robot: Robot, shape: Shape) -> Surface:
    """Returns the surface of a visual shape of a robot with the data of its meshes."""
    if isinstance(shape, MeshShape):
        mesh = next(mesh for mesh in robot.meshes if mesh.name == shape.mesh)
        points, triangles = _mesh(mesh.name, mesh.data)
        x, y, z = shape.scale
        if x * y * z < 0.0:  # a mirrored mesh: turn the triangles outside again
            triangles = [(c, b, a) for a, b, c in triangles]
        return Surface([(p[0] * x, p[1] * y, p[2] * z) for p in points], triangles)
    if isinstance(shape, Box):
        return _box(shape.size)
    if isinstance(shape, Cylinder):
        return _prism(shape.radius, shape.length)
    return _ball(shape)


def is_closed(body: Surface) -> bool:
    """Returns whether triangles enclose a body: each edge has a triangle on both sides, which run
    through the edge in opposite directions."""
    # A corner of two triangles may be two equal points.
    rounded = ((round(x, 7), round(y, 7), round(z, 7)) for x, y, z in body.points)
    numbers: dict[Vec3, int] = {}
    corners = [numbers.setdefault(point, len(numbers)) for point in rounded]
    edges = set()
    for a, b, c in body.triangles:
        i, j, k = corners[a], corners[b], corners[c]
        edges |= {(i, j), (j, k), (k, i)}
    return len(edges) == 3 * len(body.triangles) and all((j, i) in edges for i, j in edges)


@cache
def _mesh(name: str, data: bytes) -> Surface:
    """Returns the surface of a mesh of the model, whose equal points are joined."""
    read = obj_triangles if name.endswith(".obj") else stl_triangles
    numbers: dict[Vec3, int] = {}
    corners = chain.from_iterable(read(data))
    indices = iter([numbers.setdefault(corner, len(numbers)) for corner in corners])
    return Surface([*numbers], [*zip(indices, indices, indices, strict=True)])


def _box(size: Vec3) -> Surface:
    x, y, z = (0.5 * length for length in size)
    corners = [(i, j, k) for i in (-x, x) for j in (-y, y) for k in (-z, z)]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return Surface(corners, [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])


def _circle(radius: float) -> Iterator[tuple[float, float]]:
    for angle in (i * math.tau / SIDES for i in range(SIDES)):
        yield radius * math.cos(angle), radius * math.sin(angle)


def _prism(radius: float, length: float) -> Surface:
    low, high = -0.5 * length, 0.5 * length
    points = [(x, y, z) for z in (low, high) for x, y in _circle(radius)]
    triangles = []
    for i in range(SIDES):
        j = (i + 1) % SIDES
        triangles += [(i, j, SIDES + j), (i, SIDES + j, SIDES + i)]
        triangles += [(2 * SIDES, j, i), (2 * SIDES + 1, SIDES + i, SIDES + j)]
    return Surface([*points, (0.0, 0.0, low), (0.0, 0.0, high)], triangles)


def _ball(shape: Sphere) -> Surface:
    rows, radius = SIDES // 2, shape.radius
    points = [
        (x, y, -radius * math.cos(angle))
        for angle in (k * math.pi / rows for k in range(rows + 1))
        for x, y in _circle(radius * math.sin(angle))
    ]
    triangles = []
    for k in range(rows):
        for i in range(SIDES):
            j = (i + 1) % SIDES
            a, b, c, d = (r * SIDES + s for r, s in ((k, i), (k, j), (k + 1, j), (k + 1, i)))
            triangles += [(a, b, c)] * (k > 0) + [(a, c, d)] * (k < rows - 1)
    return Surface(points, triangles)


def zone_text(zone: Zone, separator: str = "\n") -> str:
    """Returns what differs in a zone from the ground around it."""
    parts = [f"friction {zone.friction:.3g}"] if zone.friction is not None else []
    if zone.rolling_resistance is not None:
        parts.append(f"rolling resistance {zone.rolling_resistance:.3g}")
    if zone.height:
        parts.append(f"height {zone.height:.3g} m")
    return separator.join(parts)
