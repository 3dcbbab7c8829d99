"""Triangle meshes of the visual shapes of a robot, and the text on a zone.

The module imports no numpy, because ``web_viewer`` also runs where numpy is not installed.
``surfaces`` returns the same triangles as arrays.  Begin with ``shape_triangles``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

from thorvaldc.compiler.shapes.mesh_formats import Corners, indexed_triangles
from thorvaldc.compiler.shapes.mesh_formats import is_closed as encloses_body
from thorvaldc.model import Box, Cylinder, MeshShape, Robot, Shape, Sphere, Vec3, Zone

Triangles = tuple[Sequence[Vec3], Sequence[Corners]]
"""Points (m) and triangles of a surface.  The sequences are shared: nobody changes them."""
SIDES = 24
"""Number of corners of a circle."""
_MERGED = 1e8
"""Points of a mesh file are one point if their coordinates times ``_MERGED`` round to the same
integers."""
_EQUAL = 1e7
"""Points of a surface are equal if their coordinates in m times ``_EQUAL`` round to the same
integers."""
# Floats near this number are integers.  The sum of the number and a float below 2**51 is therefore
# rounded as ``round`` rounds the float, but in less time, and infinity raises no exception.
_ROUND = 1.5 * 2.0**52


def shape_triangles(robot: Robot, shape: Shape) -> Triangles:
    """Returns the points and triangles of the surface of a visual shape, in its frame.

    The model must contain the data of the meshes.
    """
    if isinstance(shape, MeshShape):
        mesh = next(mesh for mesh in robot.meshes if mesh.name == shape.mesh)
        points, triangles = _mesh(mesh.name, mesh.data)
        sx, sy, sz = shape.scale
        if sx * sy * sz < 0:  # a mirrored mesh: turn the triangles outside again
            triangles = [(c, b, a) for a, b, c in triangles]
        return [(x * sx, y * sy, z * sz) for x, y, z in points], triangles
    if isinstance(shape, Box):
        return _box(shape.size)
    if isinstance(shape, Cylinder):
        return _prism(shape.radius, shape.length)
    return _ball(shape)


def is_closed(points: Sequence[Vec3], triangles: Sequence[Corners]) -> bool:
    """Returns whether triangles enclose a body.  Points that are nearly equal are one corner."""
    first: dict[Vec3, int] = {}
    corners = [
        first.setdefault((x * _EQUAL + _ROUND, y * _EQUAL + _ROUND, z * _EQUAL + _ROUND), number)
        for number, (x, y, z) in enumerate(points)
    ]
    return encloses_body((corners[i], corners[j], corners[k]) for i, j, k in triangles)


@cache
def _mesh(name: str, data: bytes) -> Triangles:
    """Returns the points and triangles of a checked STL or OBJ file, without the scale of its use.

    The points are in the order of the file.  A point that triangles share is returned once.
    """
    listed, triangles = indexed_triangles(name, data)
    numbers: dict[Vec3, int] = {}  # of the rounded points
    points: list[Vec3] = []
    corners: list[int] = []
    for x, y, z in listed:
        key = (x * _MERGED + _ROUND, y * _MERGED + _ROUND, z * _MERGED + _ROUND)
        corners.append(numbers.setdefault(key, len(points)))
        if len(numbers) > len(points):
            points.append((x, y, z))
    return points, [(corners[i], corners[j], corners[k]) for i, j, k in triangles]


def _box(size: Vec3) -> Triangles:
    x, y, z = size
    corners = [(i * x, j * y, k * z) for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return corners, [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]


def _prism(radius: float, length: float) -> Triangles:
    angles = [i * math.tau / SIDES for i in range(SIDES)]
    ring = [(radius * math.cos(a), radius * math.sin(a)) for a in angles]
    ends = (-length / 2, length / 2)
    points = [(x, y, z) for z in ends for x, y in ring] + [(0.0, 0.0, z) for z in ends]
    triangles: list[Corners] = []
    for i in range(SIDES):
        j = (i + 1) % SIDES
        triangles += [(i, j, SIDES + j), (i, SIDES + j, SIDES + i)]
        triangles += [(2 * SIDES, j, i), (2 * SIDES + 1, SIDES + i, SIDES + j)]
    return points, triangles


def _ball(shape: Sphere) -> Triangles:
    r, rows = shape.radius, SIDES // 2
    points = [
        (r * (math.sin(p) * math.cos(a)), r * (math.sin(p) * math.sin(a)), r * -math.cos(p))
        for p in (k * math.pi / rows for k in range(rows + 1))
        for a in (i * math.tau / SIDES for i in range(SIDES))
    ]
    triangles: list[Corners] = []
    for k in range(rows):
        for i in range(SIDES):
            j = (i + 1) % SIDES
            a, b, c, d = (q * SIDES + s for q, s in ((k, i), (k, j), (k + 1, j), (k + 1, i)))
            triangles += [(a, b, c)] * (k > 0) + [(a, c, d)] * (k < rows - 1)
    return points, triangles


def zone_text(zone: Zone, separator: str = "\n") -> str:
    """Returns what differs in a zone from the ground around it."""
    parts = [f"friction {zone.friction:.3g}"] if zone.friction is not None else []
    if zone.rolling_resistance is not None:
        parts.append(f"rolling resistance {zone.rolling_resistance:.3g}")
    if zone.height:
        parts.append(f"height {zone.height:.3g} m")
    return separator.join(parts)
