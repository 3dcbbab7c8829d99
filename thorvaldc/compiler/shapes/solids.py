"""Computes the mass and inertia of boxes, cylinders, spheres and closed meshes.

The result has the same bits on every machine, as every output of the compiler.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from thorvaldc.compiler.shapes.mesh_formats import indexed_triangles, is_closed
from thorvaldc.model import Box, Cylinder, Inertial, Mesh, MeshShape, Pose, Shape, Sphere, Vec3
from thorvaldc.model.spatial import combine


def uniform_solid(shape: Shape, mass: float, wall: float | None = None) -> Inertial:
    """Returns the inertia of a body of uniform density about the centre of the body.

    Reference for the formulas: Meriam and Kraige, Engineering Mechanics: Dynamics, table D/4.  A
    cylinder with a ``wall`` thickness (m) is a tube.  The inertia of a mesh is not computed and is
    returned as 0.
    """
    if isinstance(shape, Box):
        x, y, z = shape.size
        ixx, iyy, izz = (mass / 12 * v for v in (y * y + z * z, x * x + z * z, x * x + y * y))
    elif isinstance(shape, Cylinder):
        inner_radius = max(shape.radius - wall, 0.0) if wall is not None else 0.0
        squares = shape.radius**2 + inner_radius**2
        ixx = iyy = mass * (3 * squares + shape.length**2) / 12
        izz = mass * squares / 2
    elif isinstance(shape, Sphere):
        ixx = iyy = izz = 0.4 * mass * shape.radius**2
    else:
        ixx = iyy = izz = 0.0
    return Inertial(mass, (0.0, 0.0, 0.0), (ixx, iyy, izz, 0.0, 0.0, 0.0))


class Measures(NamedTuple):
    """Half diagonal (m), longest edge (m) and volume (m^3) of a shape."""

    half_diagonal: float
    length: float
    volume: float


def measures(shape: Shape) -> Measures | None:
    """Returns the measures of a shape, or ``None`` for a mesh.

    Powers of very large numbers would raise ``OverflowError``; products are infinite.
    """
    match shape:
        case Box((x, y, z)):
            return Measures(math.hypot(x, y, z) / 2.0, max(x, y, z), x * y * z)
        case Cylinder(r, h):
            return Measures(math.hypot(r, h / 2.0), max(2.0 * r, h), math.pi * (r * r) * h)
        case Sphere(r):
            return Measures(r, 2.0 * r, 4 / 3 * math.pi * (r * r * r))
    return None


def solid(shape: Shape, density: float, meshes: Mapping[str, Mesh]) -> Inertial | None:
    """Returns the mass and inertia of a shape of uniform density, in the frame of the shape.

    Returns ``None`` for a mesh that is not closed or not read, because it has no volume.

    Parameters
    ----------
    density : density in kg/m^3.
    meshes : meshes of the robot, by name.
    """
    if isinstance(shape, MeshShape):
        mesh = meshes[shape.mesh]
        return _closed_mesh(mesh, shape.scale, density) if mesh.data else None
    size = measures(shape)
    return uniform_solid(shape, density * size.volume) if size is not None else None


def solid_of_shapes(
    shapes: Iterable[tuple[Shape, Pose]], density: float, meshes: Mapping[str, Mesh]
) -> Inertial | None:
    """Returns the mass and inertia of several shapes of uniform density, or ``None``.

    The result is ``None`` without shapes, or if a mesh is not closed.  A volume that belongs to two
    shapes counts twice.

    Parameters
    ----------
    shapes : each shape with its pose in the frame of the result.
    density : density in kg/m^3.
    meshes : meshes of the robot, by name.
    """
    bodies: list[Inertial] = []
    for shape, pose in shapes:
        body = solid(shape, density, meshes)
        if body is None:
            return None
        bodies.append(body.transformed(pose))
    return combine(bodies) if bodies else None


def _closed_mesh(mesh: Mesh, scale: Vec3, density: float) -> Inertial | None:
    """Returns the mass and inertia of the body that a closed mesh encloses, or ``None``.

    The body is divided into tetrahedra between each triangle (a, b, c) and a point o.  With the
    corners relative to o, a tetrahedron has the signed volume V = a . (b x c) / 6, its centre is
    s / 4 with s = a + b + c, and the integral of x y over it is
    V / 20 (a_x a_y + b_x b_y + c_x c_y + s_x s_y).
    """
    points, triangles = indexed_triangles(mesh.name, mesh.data)
    if not is_closed(triangles):
        return None
    points = [(x * scale[0], y * scale[1], z * scale[2]) for x, y, z in points]
    ox, oy, oz = points[triangles[0][0]]
    points = [(x - ox, y - oy, z - oz) for x, y, z in points]
    # The first addition to -0.0 gives the first value, also -0.0.
    volume = x = y = z = xx = yy = zz = xy = xz = yz = -0.0
    for i, j, k in triangles:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = points[i], points[j], points[k]
        sx, sy, sz = ax + bx + cx, ay + by + cy, az + bz + cz
        v = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        v /= 6
        volume += v
        x += v * sx / 4
        y += v * sy / 4
        z += v * sz / 4
        v /= 20
        xx += v * (ax * ax + bx * bx + cx * cx + sx * sx)
        yy += v * (ay * ay + by * by + cy * cy + sy * sy)
        zz += v * (az * az + bz * bz + cz * cz + sz * sz)
        xy += v * (ax * ay + bx * by + cx * cy + sx * sy)
        xz += v * (ax * az + bx * bz + cx * cz + sx * sz)
        yz += v * (ay * az + by * bz + cy * cz + sy * sz)
    if volume == 0.0:
        return None
    x, y, z = x / volume, y / volume, z / volume
    # The volume is negative if the triangles face inwards or the scale mirrors the mesh.
    mass = density * abs(volume)
    xx, yy, zz, xy, xz, yz = (total / volume * mass for total in (xx, yy, zz, xy, xz, yz))
    xx, yy, zz = xx - mass * x * x, yy - mass * y * y, zz - mass * z * z
    return Inertial(
        mass,
        (x + ox, y + oy, z + oz),
        (yy + zz, xx + zz, xx + yy, mass * x * y - xy, mass * x * z - xz, mass * y * z - yz),
    )
