"""Computes the mass and inertia of boxes, cylinders, spheres and closed meshes.

The result has the same bits on every machine, as every output of the compiler.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from thorvaldc.compiler.shapes.mesh_formats import mesh_triangles
from thorvaldc.model import Box, Cylinder, Inertial, Mesh, Pose, Shape, Sphere, Vec3
from thorvaldc.model.spatial import combine
from thorvaldc.model.stl import Triangle

_PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Axes of the products of inertia."""


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


def solid(shape: Shape, density: float, meshes: Mapping[str, Mesh]) -> Inertial | None:
    """Returns the mass and inertia of a shape of uniform density, in the frame of the shape.

    Returns ``None`` for a mesh that is not closed, because it has no volume.

    Parameters
    ----------
    density : density in kg/m^3.
    meshes : meshes of the robot, by name.
    """
    if isinstance(shape, Box):
        volume = shape.size[0] * shape.size[1] * shape.size[2]
    elif isinstance(shape, Cylinder):
        volume = math.pi * shape.radius**2 * shape.length
    elif isinstance(shape, Sphere):
        volume = 4 / 3 * math.pi * shape.radius**3
    else:
        return _closed_mesh(meshes[shape.mesh], shape.scale, density)
    return uniform_solid(shape, density * volume)


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


def _is_closed(triangles: Iterable[Triangle]) -> bool:
    """Whether each edge belongs to two triangles that pass along it in opposite directions.

    Corners with equal coordinates are the same point.
    """
    points: dict[Vec3, int] = {}
    edges: set[tuple[int, int]] = set()
    count = 0
    for corners in triangles:
        i, j, k = (points.setdefault(corner, len(points)) for corner in corners)
        # Some programs fill gaps with triangles without area.
        if i != j and j != k and k != i:
            edges |= {(i, j), (j, k), (k, i)}
            count += 3
    return 0 < count == len(edges) and all((end, start) in edges for start, end in edges)


def _closed_mesh(mesh: Mesh, scale: Vec3, density: float) -> Inertial | None:
    """Returns the mass and inertia of the body that a closed mesh encloses, or ``None``.

    The body is divided into tetrahedra between each triangle (a, b, c) and a point o.  With the
    corners relative to o, a tetrahedron has the signed volume V = a . (b x c) / 6, its centre is
    s / 4 with s = a + b + c, and the integral of x y over it is
    V / 20 (a_x a_y + b_x b_y + c_x c_y + s_x s_y).
    """
    x, y, z = scale
    triangles: list[Triangle] = [
        (
            (a[0] * x, a[1] * y, a[2] * z),
            (b[0] * x, b[1] * y, b[2] * z),
            (c[0] * x, c[1] * y, c[2] * z),
        )
        for a, b, c in mesh_triangles(mesh.name, mesh.data)
    ]
    if not _is_closed(triangles):
        return None
    origin = triangles[0][0]
    totals = [-0.0] * 10  # so that the first addition gives the first value, also -0.0
    for corners in triangles:
        a, b, c = ([p[i] - origin[i] for i in range(3)] for p in corners)
        s = [a[i] + b[i] + c[i] for i in range(3)]
        v = a[0] * (b[1] * c[2] - b[2] * c[1])
        v += a[1] * (b[2] * c[0] - b[0] * c[2])
        v += a[2] * (b[0] * c[1] - b[1] * c[0])
        v /= 6
        totals[0] += v
        for i in range(3):
            totals[1 + i] += v * s[i] / 4
        for number, (i, j) in enumerate(_PRODUCTS, 4):
            totals[number] += v / 20 * (a[i] * a[j] + b[i] * b[j] + c[i] * c[j] + s[i] * s[j])
    volume = totals[0]
    if volume == 0.0:
        return None
    x, y, z = (total / volume for total in totals[1:4])
    # The volume is negative if the triangles face inwards or the scale mirrors the mesh.
    mass = density * abs(volume)
    xx, yy, zz, xy, xz, yz = (total / volume * mass for total in totals[4:])
    xx, yy, zz = xx - mass * x * x, yy - mass * y * y, zz - mass * z * z
    return Inertial(
        mass,
        (x + origin[0], y + origin[1], z + origin[2]),
        (yy + zz, xx + zz, xx + yy, mass * x * y - xy, mass * x * z - xz, mass * y * z - yz),
    )
