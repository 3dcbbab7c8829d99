"""Closed solids of vertices and triangles, for the meshes of the library.

Every function returns a :class:`Solid` whose faces point outwards.  ``join`` puts solids side
by side or into one another, without Boolean operations: each part remains closed, so the
whole is closed too.  Lengths are in m, angles in rad.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]
Outline = Sequence[tuple[float, float]]

ALONG_Y = -math.pi / 2  # rotation about x from z to y


@dataclass(frozen=True)
class Solid:
    """``vertices`` (n, 3) in m; ``faces`` (m, 3), counter-clockwise seen from outside."""

    vertices: Points
    faces: Faces

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
        """Returns the solid, translated."""
        return Solid(self.vertices + np.array([x, y, z]), self.faces)

    def turned(self, axis: str, angle: float) -> Solid:
        """Returns the solid, rotated by ``angle`` about the axis ``x``, ``y`` or ``z``."""
        c, s = math.cos(angle), math.sin(angle)
        matrix = {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
        return Solid(self.vertices @ np.array(matrix).T, self.faces)

    def scaled(self, x: float, y: float, z: float) -> Solid:
        """Returns the solid, scaled by positive factors."""
        return Solid(self.vertices * np.array([x, y, z]), self.faces)


Meshes = dict[str, Solid]
"""The meshes of a module by file name, without the extension."""


def along_y(solid: Solid) -> Solid:
    """Rotates a solid that is built along z, so that it is along y."""
    return solid.turned("x", ALONG_Y)


def along_x(solid: Solid) -> Solid:
    """Rotates a solid that is built along z, so that it is along x."""
    return solid.turned("y", math.pi / 2)


def join(solids: Iterable[Solid]) -> Solid:
    """Returns all solids as one."""
    vertices: list[Points] = []
    faces: list[Faces] = []
    offset = 0
    for solid in solids:
        vertices.append(solid.vertices)
        faces.append(solid.faces + offset)
        offset += len(solid.vertices)
    return Solid(np.vstack(vertices), np.vstack(faces))


def around(solid: Solid, count: int, axis: str = "z", start: float = 0.0) -> Solid:
    """Returns ``count`` copies at equal angles about an axis, the first at ``start``."""
    return join(solid.turned(axis, start + 2 * math.pi * i / count) for i in range(count))


def loft(rings: Sequence[Points], *, closed: bool = False) -> Solid:
    """Returns the solid whose surface connects rings with the same number of points.

    A fan of triangles from its centre closes each end, so the end must be star-shaped about
    its centre.  With ``closed``, the last ring is connected to the first instead.
    """
    count, size = len(rings), len(rings[0])
    vertices = [np.asarray(ring, dtype=np.float64) for ring in rings]
    faces: list[tuple[int, int, int]] = []
    for i in range(count if closed else count - 1):
        a, b = i * size, (i + 1) % count * size
        for j in range(size):
            k = (j + 1) % size
            faces += [(a + j, a + k, b + k), (a + j, b + k, b + j)]
    if not closed:
        vertices += [rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]]
        first, last, end = count * size, count * size + 1, (count - 1) * size
        for j in range(size):
            k = (j + 1) % size
            faces += [(first, k, j), (last, end + j, end + k)]
    return _outward(Solid(np.vstack(vertices), np.array(faces, dtype=np.int64)))


def _outward(solid: Solid) -> Solid:
    """Returns the solid with outward faces: then the sum of signed volumes is positive."""
    a, b, c = (solid.vertices[solid.faces[:, i]] for i in range(3))
    volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum())
    return solid if volume > 0 else Solid(solid.vertices, solid.faces[:, ::-1])


def revolve(profile: Outline, segments: int, *, closed: bool = False) -> Solid:
    """Returns the solid of revolution about z of a profile of (radius, height).

    With ``closed``, the profile is closed and the solid is a ring.  Otherwise flat discs close
    the ends.
    """
    angles = np.arange(segments) * (2 * math.pi / segments)
    cos, sin = np.cos(angles), np.sin(angles)
    rings = [np.column_stack([r * cos, r * sin, np.full(segments, h)]) for r, h in profile]
    return loft(rings, closed=closed)


def cylinder(radius: float, length: float, segments: int = 24, bevel: float = 0.0) -> Solid:
    """Returns a cylinder along z, with its centre at the origin."""
    h = length / 2
    if bevel:
        profile = [
            (radius - bevel, -h),
            (radius, bevel - h),
            (radius, h - bevel),
            (radius - bevel, h),
        ]
    else:
        profile = [(radius, -h), (radius, h)]
    return revolve(profile, segments)


def extrude(outline: Outline, low: float, high: float, bevel: float = 0.0) -> Solid:
    """Returns a prism with a star-shaped outline (x, y) from z = ``low`` to ``high``."""
    points = np.asarray(outline, dtype=np.float64)

    def at(z: float, inset: float) -> Points:
        flat = _inset(points, inset) if inset else points
        return np.column_stack([flat, np.full(len(flat), z)])

    if not bevel:
        return loft([at(low, 0.0), at(high, 0.0)])
    return loft([at(low, bevel), at(low + bevel, 0.0), at(high - bevel, 0.0), at(high, bevel)])


def _inset(points: Points, distance: float) -> Points:
    """Moves the edges of a polygon inwards by ``distance``; corners move along their mitres.

    With the unit normals n1 and n2 of its edges, a corner moves by
    ``distance`` times 2 (n1 + n2) / |n1 + n2|^2.
    """
    area = float(
        np.sum(points[:, 0] * np.roll(points[:, 1], -1) - points[:, 1] * np.roll(points[:, 0], -1))
    )
    edge = np.roll(points, -1, axis=0) - points
    normal = np.column_stack([-edge[:, 1], edge[:, 0]]) * (1.0 if area > 0 else -1.0)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    mitre = normal + np.roll(normal, 1, axis=0)
    length = np.einsum("ij,ij->i", mitre, mitre)[:, None] / 2.0
    inner: Points = points + distance * mitre / length
    return inner


def rectangle(x: float, y: float, chamfer: float) -> list[tuple[float, float]]:
    """Returns a rectangle with chamfered corners, centred at the origin."""
    a, b, c = x / 2, y / 2, chamfer
    corners = [(a, b - c), (a - c, b), (c - a, b), (-a, b - c)]
    return corners + [(-px, -py) for px, py in corners]


def rounded_rectangle(x: float, y: float, radius: float, steps: int) -> list[tuple[float, float]]:
    """Returns a centred rectangle with round corners of ``steps`` edges each."""
    points = []
    for i, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        for j in range(steps + 1):
            angle = (i + j / steps) * math.pi / 2
            points.append(
                (
                    sx * (x / 2 - radius) + radius * math.cos(angle),
                    sy * (y / 2 - radius) + radius * math.sin(angle),
                )
            )
    return points


def block(x: float, y: float, z: float, bevel: float = 0.0) -> Solid:
    """Returns a centred box with bevelled edges."""
    if not bevel:
        return extrude(
            [(x / 2, y / 2), (-x / 2, y / 2), (-x / 2, -y / 2), (x / 2, -y / 2)], -z / 2, z / 2
        )
    return extrude(rectangle(x, y, bevel), -z / 2, z / 2, bevel)


def bolt(radius: float, height: float) -> Solid:
    """Returns the hexagonal head of a bolt, with its lower face at z = 0."""
    return cylinder(radius, height, 6).moved(z=height / 2)


def sweep(path: Points, radius: float, segments: int) -> Solid:
    """Returns a round bar along a path of points (n, 3)."""
    rings = []
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    side = np.array([0.0, 0.0, 1.0]) if abs(tangents[0][2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    angles = np.arange(segments) * (2 * math.pi / segments)
    for point, tangent in zip(path, tangents, strict=True):
        # Project the last direction onto the normal plane: the bar does not twist.
        side = side - tangent * float(side @ tangent)
        side /= np.linalg.norm(side)
        binormal = np.cross(tangent, side)
        rings.append(
            point + radius * (np.outer(np.cos(angles), side) + np.outer(np.sin(angles), binormal))
        )
    return loft(rings)


def coil(radius: float, wire: float, height: float, turns: int, per_turn: int = 16) -> Solid:
    """Returns a coil spring along z from 0 to ``height``; ``wire`` is the radius of its wire."""
    count = turns * per_turn + 1
    t = np.linspace(0.0, 1.0, count)
    angle = 2 * math.pi * turns * t
    path = np.column_stack(
        [radius * np.cos(angle), radius * np.sin(angle), wire + (height - 2 * wire) * t]
    )
    return sweep(path, wire, 6)


def to_stl(solid: Solid) -> bytes:
    """Returns a binary STL file.

    Coordinates are rounded to a micrometre, because the last bits of ``sin`` differ between C
    libraries and files must not.  Triangles without area are left out.
    """
    rounded = np.round(solid.vertices, 6) + 0.0
    a, b, c = (rounded[solid.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    keep = length > 1e-12
    normal = np.round(normal[keep] / length[keep, None], 4) + 0.0
    record = np.zeros(
        int(keep.sum()), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")]
    )
    record["normal"] = normal
    record["corners"] = np.stack([a[keep], b[keep], c[keep]], axis=1)
    return b"thorvaldc".ljust(80, b" ") + struct.pack("<I", len(record)) + record.tobytes()
