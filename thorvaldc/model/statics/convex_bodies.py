"""Convex bodies, and how deep they are inside each other.

The overlap of two bodies A and B in the direction d (a unit vector) is

    f(d) = max over a in A of a . d  -  min over b in B of b . d.

Moved by f(d) along d, B is on the far side of a plane, so the bodies do not touch. They are apart
if f(d) < 0 for any direction, and the least f(d) of all directions is the shortest way by which B
gets out of A. Two boxes have their least f(d) along an axis of one of them or along the cross
product of two axes (separating axis theorem). Further directions are the line between the centres,
the radial direction of a cylinder, and those by which the algorithm of Gilbert approaches the point
of A - B that is nearest to the origin: they find a plane between bodies of any shape. At last, the
best of them is turned along the slope of f as long as f falls.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.model import Box, Cylinder, MeshShape, Pose, Shape, Vec3
from thorvaldc.model.spatial import Quat, add, cross, dot, norm, quat_to_matrix, scale, sub
from thorvaldc.model.stl import mesh_vertices

_ITERATIONS = 60
_SAME = 1e-9  # m
_AXES: tuple[Vec3, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Overlap(NamedTuple):
    """The shortest way by which a body gets out of another one.

    ``depth`` is its length in m, negative for bodies that are apart, and ``direction`` its
    direction, a unit vector.
    """

    depth: float
    direction: Vec3


class ConvexBody:
    """A box, cylinder, sphere or the convex hull of a mesh.

    - ``center``: centre in m; ``axes``: unit vectors of the axes of the shape.
    - ``half``: half edges of a box, radius and half length of a cylinder or a sphere, in m.
    - ``reach``: radius in m of a sphere about the centre that contains the body.

    ``data``: bytes of the mesh file of a mesh.  Some vertices stand for the hull of a mesh, so the
    body is inside the mesh.
    """

    __slots__ = ("axes", "center", "half", "is_box", "points", "reach")

    def __init__(self, shape: Shape, pose: Pose, data: bytes = b"") -> None:
        rows = quat_to_matrix(pose.quat)
        columns = ((rows[0][k], rows[1][k], rows[2][k]) for k in range(3))
        self.axes: tuple[Vec3, ...] = tuple(columns)
        self.center = pose.xyz
        self.is_box = isinstance(shape, Box)
        self.half: tuple[float, ...] = ()
        self.points: tuple[Vec3, ...] = ()
        match shape:
            case Box((x, y, z)):
                self.half = x / 2, y / 2, z / 2
                self.reach = math.hypot(*self.half)
            case Cylinder(radius, length):
                self.axes = self.axes[2:]
                self.half = radius, length / 2
                self.reach = math.hypot(*self.half)
            case MeshShape(name, factors):
                self.points = tuple(map(pose.apply, _outer_vertices(name, data, factors)))
                self.reach = max((norm(sub(p, pose.xyz)) for p in self.points), default=0.0)
            case _:
                self.axes = ()
                self.half = (shape.radius, 0.0)
                self.reach = shape.radius

    @property
    def thickness(self) -> float:
        """The least extent of a box, cylinder or sphere, in m, else the diameter of its sphere."""
        return 2.0 * min((size for size in self.half if size > 0.0), default=self.reach)

    def moved(self, motion: Pose) -> ConvexBody:
        """Return the body after a motion."""
        body = object.__new__(ConvexBody)
        body.axes = tuple(map(motion.rotate, self.axes))
        body.center = motion.apply(self.center)
        body.is_box, body.half, body.reach = self.is_box, self.half, self.reach
        body.points = tuple(map(motion.apply, self.points))
        return body

    def furthest(self, direction: Vec3) -> Vec3:
        """Return the point of the body that is furthest in a direction, a unit vector."""
        if self.points:
            return max(self.points, key=lambda point: dot(point, direction))
        x, y, z = self.center
        dx, dy, dz = direction
        if self.is_box:
            for (ax, ay, az), half in zip(self.axes, self.half, strict=True):
                size = half if ax * dx + ay * dy + az * dz > 0.0 else -half
                x, y, z = x + size * ax, y + size * ay, z + size * az
            return x, y, z
        radius, half = self.half
        for ax, ay, az in self.axes:
            along = ax * dx + ay * dy + az * dz
            size = half if along > 0.0 else -half
            x, y, z = x + size * ax, y + size * ay, z + size * az
            dx, dy, dz = dx - along * ax, dy - along * ay, dz - along * az
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length > _SAME:
            size = radius / length
            x, y, z = x + size * dx, y + size * dy, z + size * dz
        return x, y, z

    def extent(self, direction: Vec3) -> tuple[float, float]:
        """Return the least and the largest coordinate in m along a direction, a unit vector."""
        low = dot(self.furthest(scale(-1.0, direction)), direction)
        return low, dot(self.furthest(direction), direction)


@functools.lru_cache(maxsize=256)
def _outer_vertices(name: str, data: bytes, factors: Vec3) -> tuple[Vec3, ...]:
    """Return the vertices of a mesh that are furthest in directions all around, in its frame."""
    sx, sy, sz = factors
    vertices = [(x * sx, y * sy, z * sz) for x, y, z in mesh_vertices(name, data)]
    if not vertices:
        return ()
    steps = (-1.0, -0.5, 0.0, 0.5, 1.0)
    directions = [d for d in itertools.product(steps, steps, steps) if 1.0 in map(abs, d)]
    return tuple(dict.fromkeys(max(vertices, key=lambda v: dot(v, d)) for d in directions))


def bounds_of(shape: Shape, pose: Pose, data: bytes) -> tuple[Vec3, Vec3] | None:
    """Return the lower and the upper corner in m of the box around a shape, along the axes of the
    frame of ``pose``, or ``None`` for a mesh without bytes.

    ``data``: bytes of the mesh file of a mesh.
    """
    if isinstance(shape, MeshShape):
        # Equal orientations of equal modules differ by rounding, and by the sign of a zero.
        w, x, y, z = (round(value, 12) + 0.0 for value in pose.quat)
        box = _mesh_bounds(shape, data, (w, x, y, z))
        return None if box is None else (add(pose.xyz, box[0]), add(pose.xyz, box[1]))
    body = ConvexBody(shape, pose)
    (a, b), (c, d), (e, f) = map(body.extent, _AXES)
    return (a, c, e), (b, d, f)


@functools.lru_cache(maxsize=256)
def _mesh_bounds(shape: MeshShape, data: bytes, quat: Quat) -> tuple[Vec3, Vec3] | None:
    """The designs of a study have the same meshes."""
    vertices = mesh_vertices(shape.mesh, data)
    if not vertices:
        return None
    sx, sy, sz = shape.scale
    lower, upper = [], []
    for a, b, c in quat_to_matrix(quat):
        a, b, c = a * sx, b * sy, c * sz
        values = [a * vx + b * vy + c * vz for vx, vy, vz in vertices]
        lower.append(min(values))
        upper.append(max(values))
    return (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])


def overlap_along(first: ConvexBody, second: ConvexBody, direction: Vec3) -> float:
    """Return how far the second body must move in a direction, a unit vector, until it is free."""
    return dot(_difference(first, second, direction), direction)


def overlap_of(
    first: ConvexBody, second: ConvexBody, enough: float = -math.inf, near: float = 0.0
) -> Overlap:
    """Return the shortest way by which the second body gets out of the first one.

    The search for the shortest way ends at a depth of at most ``enough``, and where the distance
    of the bodies is at most ``near``, both in m.
    """
    best = Overlap(math.inf, (0.0, 0.0, 1.0))
    for direction in _directions(first, second):
        depth = overlap_along(first, second, direction)
        if depth < best.depth:
            best = Overlap(depth, direction)
            if depth <= enough:
                return best
    nearest = _difference(first, second, best.direction)
    for _ in range(_ITERATIONS):
        distance = norm(nearest)
        if distance <= near:
            return best
        if distance < _SAME:
            break
        direction = scale(-1.0 / distance, nearest)
        point = _difference(first, second, direction)
        depth = dot(point, direction)
        if depth < best.depth:
            best = Overlap(depth, direction)
            if depth <= enough:
                return best
        way = sub(point, nearest)
        square = dot(way, way)
        share = -dot(nearest, way) / square if square > _SAME * _SAME else 0.0
        if share <= _SAME:
            break
        nearest = add(nearest, scale(min(share, 1.0), way))
    turn = 0.5
    for _ in range(_ITERATIONS):
        # The depth changes with the direction by the difference point, without its part along it.
        point = _difference(first, second, best.direction)
        slope = sub(point, scale(best.depth, best.direction))
        steepness = norm(slope)
        if best.depth <= enough or steepness < _SAME:
            break
        tilted = sub(best.direction, scale(turn / steepness, slope))
        direction = scale(1.0 / norm(tilted), tilted)
        depth = overlap_along(first, second, direction)
        if depth < best.depth:
            best = Overlap(depth, direction)
        else:
            turn *= 0.75
    return best


def _difference(first: ConvexBody, second: ConvexBody, direction: Vec3) -> Vec3:
    """Return the point of first - second that is furthest in a direction."""
    return sub(first.furthest(direction), second.furthest(scale(-1.0, direction)))


def _directions(first: ConvexBody, second: ConvexBody) -> Iterator[Vec3]:
    """Yield directions in which two bodies may be apart, from the first towards the second."""
    between = sub(second.center, first.center)
    radial = (
        sub(between, scale(dot(between, body.axes[0]), body.axes[0]))
        for body in (first, second)
        if len(body.axes) == 1
    )
    products = (cross(a, b) for a in first.axes for b in second.axes)
    for vectors in ((between,), first.axes, second.axes, radial, products):
        for vector in vectors:
            length = norm(vector)
            if length > 1e-6:
                yield scale(math.copysign(1.0 / length, dot(vector, between)), vector)
