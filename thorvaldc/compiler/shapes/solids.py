"""Computes the mass and inertia of boxes, cylinders, spheres and closed meshes.

The result has the same bits on every machine, as every output of the compiler.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from thorvaldc.compiler.shapes.mesh_formats import obj_triangles
from thorvaldc.model import Box, Cylinder, Inertial, Mesh, Pose, Shape, Sphere, Vec3
from thorvaldc.model.spatial import combine
from thorvaldc.model.stl import HEADER, NUMPY_RECORD

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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


def mesh_triangles(mesh: Mesh) -> NDArray[np.float64]:
    """Returns the corners of the triangles of a mesh that ``load_mesh`` has read, as (n, 3, 3)."""
    import numpy as np

    if not mesh.name.endswith(".obj"):
        records = np.frombuffer(mesh.data, NUMPY_RECORD, offset=HEADER)
        return np.asarray(records["corners"], np.float64)
    return np.array([*obj_triangles(mesh.data)], np.float64)


def _is_closed(triangles: NDArray[np.float64]) -> bool:
    """Whether each edge belongs to two triangles that pass along it in opposite directions.

    Corners with equal coordinates are the same point.
    """
    import numpy as np

    count = len(triangles)
    points = np.unique(triangles.reshape(3 * count, 3), axis=0, return_inverse=True)[1]
    corners = points.reshape(count, 3)
    following = np.roll(corners, -1, axis=1)
    # Some programs fill gaps with triangles without area.
    has_area = np.all(corners != following, axis=1)
    start, end = corners[has_area].ravel(), following[has_area].ravel()
    edges, repeated = np.unique(start * (3 * count) + end, return_counts=True)
    opposite = np.unique(end * (3 * count) + start)
    return len(edges) > 0 and bool(np.all(repeated == 1)) and np.array_equal(edges, opposite)


def _closed_mesh(mesh: Mesh, scale: Vec3, density: float) -> Inertial | None:
    """Returns the mass and inertia of the body that a closed mesh encloses, or ``None``.

    The body is divided into tetrahedra between each triangle (a, b, c) and a point o.  With the
    corners relative to o, a tetrahedron has the signed volume V = a . (b x c) / 6, its centre is
    s / 4 with s = a + b + c, and the integral of x y over it is
    V / 20 (a_x a_y + b_x b_y + c_x c_y + s_x s_y).
    """
    import numpy as np

    triangles = mesh_triangles(mesh) * np.array(scale)
    if not _is_closed(triangles):
        return None
    origin = triangles[0, 0]
    # Columns of x, y and z coordinates.
    a, b, c = ((triangles[:, i] - origin).T for i in range(3))
    s = a + b + c
    v = a[0] * (b[1] * c[2] - b[2] * c[1])
    v += a[1] * (b[2] * c[0] - b[0] * c[2])
    v += a[2] * (b[0] * c[1] - b[1] * c[0])
    v /= 6

    def total(values: NDArray[np.float64]) -> float:
        # The method ``sum`` of numpy adds in an order that depends on the processor.
        return float(np.cumsum(values)[-1])

    volume = total(v)
    if volume == 0.0:
        return None
    x, y, z = (total(v * s[i] / 4) / volume for i in range(3))
    # The volume is negative if the triangles face inwards or the scale mirrors the mesh.
    mass = density * abs(volume)
    xx, yy, zz, xy, xz, yz = (
        total(v / 20 * (a[i] * a[j] + b[i] * b[j] + c[i] * c[j] + s[i] * s[j])) / volume * mass
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    )
    xx, yy, zz = xx - mass * x * x, yy - mass * y * y, zz - mass * z * z
    return Inertial(
        mass,
        (x + float(origin[0]), y + float(origin[1]), z + float(origin[2])),
        (yy + zz, xx + zz, xx + yy, mass * x * y - xy, mass * x * z - xz, mass * y * z - yz),
    )
