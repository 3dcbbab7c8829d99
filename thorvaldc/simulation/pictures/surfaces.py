"""Triangle meshes of the visual shapes of a robot, and the text on a zone."""

from __future__ import annotations

import io
import math
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from thorvaldc.model import Box, Cylinder, MeshShape, Pose, Robot, Shape, Sphere, Vec3, Zone

Points = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]
SIDES = 24
"""Number of corners of a circle."""
_DIRECTIONS = 48
"""Number of directions in which an outline has a corner."""


def surface(robot: Robot, shape: Shape) -> tuple[Points, Faces]:
    """Returns the vertices and triangles of the surface of a visual shape.

    The vertices (m) are in the frame of the shape, with the array shape (n, 3).  Each triangle has
    three vertex indices, with the array shape (m, 3).
    """
    if isinstance(shape, MeshShape):
        mesh = next(mesh for mesh in robot.meshes if mesh.name == shape.mesh)
        points, faces = _mesh(mesh.name, mesh.data)
        if np.prod(shape.scale) < 0:  # a mirrored mesh: turn the triangles outside again
            faces = faces[:, ::-1]
        return points * np.asarray(shape.scale), faces
    if isinstance(shape, Box):
        return _box(shape.size)
    if isinstance(shape, Cylinder):
        return _prism(shape.radius, shape.length)
    return _ball(shape)


def is_closed(points: Points, faces: Faces) -> bool:
    """Returns whether triangles enclose a body: each edge has a triangle on both sides, which run
    through the edge in opposite directions."""
    # A corner of two triangles may be two equal points.
    _, corners = np.unique(np.round(points, 7), axis=0, return_inverse=True)
    triangles = corners.reshape(-1)[faces]
    starts = triangles.reshape(-1)
    ends = np.roll(triangles, -1, axis=1).reshape(-1)
    edges, opposite = starts * len(points) + ends, ends * len(points) + starts
    return len(np.unique(edges)) == len(edges) and bool(np.isin(opposite, edges).all())


@cache
def _mesh(name: str, data: bytes) -> tuple[Points, Faces]:
    import trimesh

    loaded: Any = trimesh.load(io.BytesIO(data), file_type=name.rsplit(".", 1)[-1], force="mesh")
    return np.asarray(loaded.vertices, dtype=float), np.asarray(loaded.faces, dtype=np.int64)


def _box(size: Vec3) -> tuple[Points, Faces]:
    corners = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]
    return np.asarray(corners) * np.asarray(size), np.asarray(faces)


def _prism(radius: float, length: float) -> tuple[Points, Faces]:
    angles = np.arange(SIDES) * math.tau / SIDES
    ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
    low, high = (np.column_stack([ring, np.full(SIDES, z)]) for z in (-length / 2, length / 2))
    ends = np.array([[0.0, 0.0, -length / 2], [0.0, 0.0, length / 2]])
    faces: list[tuple[int, int, int]] = []
    for i in range(SIDES):
        j = (i + 1) % SIDES
        faces += [(i, j, SIDES + j), (i, SIDES + j, SIDES + i)]
        faces += [(2 * SIDES, j, i), (2 * SIDES + 1, SIDES + i, SIDES + j)]
    return np.vstack([low, high, ends]), np.asarray(faces)


def _ball(shape: Sphere) -> tuple[Points, Faces]:
    rows = SIDES // 2
    points = [
        (math.sin(p) * math.cos(a), math.sin(p) * math.sin(a), -math.cos(p))
        for p in (k * math.pi / rows for k in range(rows + 1))
        for a in (i * math.tau / SIDES for i in range(SIDES))
    ]
    faces: list[tuple[int, int, int]] = []
    for k in range(rows):
        for i in range(SIDES):
            j = (i + 1) % SIDES
            a, b, c, d = (r * SIDES + s for r, s in ((k, i), (k, j), (k + 1, j), (k + 1, i)))
            faces += [(a, b, c)] * (k > 0) + [(a, c, d)] * (k < rows - 1)
    return shape.radius * np.asarray(points), np.asarray(faces)


def outline_from_above(robot: Robot, shape: Shape, pose: Pose) -> tuple[Points, float]:
    """Returns the approximate convex outline of a shape, seen from above, and its highest z (m).

    ``pose``: the frame of the shape in the frame of the outline, with the array shape (n, 2) in m.
    """
    local, _ = surface(robot, shape)
    turned = np.array([pose.rotate(e) for e in ((1, 0, 0), (0, 1, 0), (0, 0, 1))])
    points = local @ turned + np.asarray(pose.xyz)
    outline = convex(points[:, :2])
    return outline, float(points[:, 2].max())


def convex(points: Points) -> Points:
    """Returns an approximate convex hull of points, with the array shape (n, 2).

    The corners of the hull are the furthest points in each of ``_DIRECTIONS`` directions.
    """
    angles = np.arange(_DIRECTIONS) * math.tau / _DIRECTIONS
    furthest = np.argmax(points @ np.array([np.cos(angles), np.sin(angles)]), axis=0)
    outline: Points = points[furthest]
    return outline


def zone_text(zone: Zone, separator: str = "\n") -> str:
    """Returns what differs in a zone from the ground around it."""
    parts = [f"friction {zone.friction:.3g}"] if zone.friction is not None else []
    if zone.rolling_resistance is not None:
        parts.append(f"rolling resistance {zone.rolling_resistance:.3g}")
    if zone.height:
        parts.append(f"height {zone.height:.3g} m")
    return separator.join(parts)
