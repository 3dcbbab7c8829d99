"""Length, width, height, wheelbase, track and ground clearance of a robot."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from thorvaldc.model import (
    Box,
    Cylinder,
    MeshShape,
    Robot,
    Shape,
    Sphere,
    Vec3,
    Wheel,
)
from thorvaldc.model import quantities as si
from thorvaldc.model.spatial import Quat, add, quat_to_matrix, rotate
from thorvaldc.model.statics.ground_contacts import with_ground_contacts
from thorvaldc.model.statics.joint_tree import JointTree, tree_of
from thorvaldc.model.statics.occupied_space import solids_of
from thorvaldc.model.stl import mesh_vertices
from thorvaldc.model.sums import float_sum

_SMALLEST_DISTANCE = 1e-3
"""A wheelbase or track below this distance (m) is no distance between two axles."""


@dataclass(frozen=True, slots=True)
class Size:
    """Extents of a robot with all joints at position 0, in m.

    - ``length``, ``width``, ``height``: extents along x, y and z of ``base_link``. The height is
      measured from the ground.
    - ``lower``, ``upper``: corners of the box around the robot in ``base_link``.
    - ``wheelbase``, ``track``: largest distance of two wheels along x and along y, or ``None`` if
      all wheels are in one line. A wheel that steers or swivels counts where its axis meets the
      ground.
    - ``ground_clearance``: height of the lowest part that does not roll or stand on the ground, or
      ``None`` without parts.
    - ``lowest_module``: path of the module with that part.
    - ``meshes_left_out``: names of mesh files whose bytes the model does not contain.
    """

    length: si.Metres
    width: si.Metres
    height: si.Metres
    lower: si.Position
    upper: si.Position
    wheelbase: si.Metres | None
    track: si.Metres | None
    ground_clearance: si.Metres | None
    lowest_module: str
    meshes_left_out: tuple[str, ...]


class _Extents:
    """The extents of the shapes of a robot.  ``left_out``: names of the meshes without bytes."""

    def __init__(self, robot: Robot) -> None:
        self._data = {mesh.name: mesh.data for mesh in robot.meshes}
        self.left_out: dict[str, None] = {}

    def of(self, shape: Shape, quat: Quat) -> tuple[Vec3, Vec3] | None:
        """Return the lower and the upper corner of the box around a shape, relative to its origin.

        ``quat`` is the orientation of the shape in ``base_link``. Returns ``None`` for a mesh
        without bytes.
        """
        if isinstance(shape, MeshShape):
            return self._of_mesh(shape, quat)
        half = _half_extents(shape, quat)
        return (-half[0], -half[1], -half[2]), half

    def _of_mesh(self, shape: MeshShape, quat: Quat) -> tuple[Vec3, Vec3] | None:
        # Equal orientations of equal modules differ by rounding, and by the sign of a zero.
        w, x, y, z = (round(value, 12) + 0.0 for value in quat)
        data = self._data.get(shape.mesh, b"")
        box = _mesh_box(shape.mesh, data, shape.scale, (w, x, y, z))
        if box is None:
            self.left_out[shape.mesh] = None
        return box


@functools.lru_cache(maxsize=256)
def _mesh_box(name: str, data: bytes, scale: Vec3, quat: Quat) -> tuple[Vec3, Vec3] | None:
    """Return the corners of the box around a mesh, or ``None`` for a mesh without bytes.

    The designs of a study have the same meshes.
    """
    vertices = mesh_vertices(name, data)
    if not vertices:
        return None
    sx, sy, sz = scale
    lower, upper = [], []
    for a, b, c in quat_to_matrix(quat):
        a, b, c = a * sx, b * sy, c * sz
        values = [a * vx + b * vy + c * vz for vx, vy, vz in vertices]
        lower.append(min(values))
        upper.append(max(values))
    return (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])


def _half_extents(shape: Box | Cylinder | Sphere, quat: Quat) -> Vec3:
    """Return half of the extents of a shape along the axes of ``base_link``.

    A cylinder with the axis a extends along the direction i by r sqrt(1 - a_i^2) + l / 2 |a_i|.
    """
    match shape:
        case Box(size=size):
            x, y, z = (
                float_sum(abs(entry) * edge for entry, edge in zip(row, size, strict=True)) / 2
                for row in quat_to_matrix(quat)
            )
            return x, y, z
        case Cylinder(radius=radius, length=length):
            x, y, z = (
                radius * math.sqrt(max(1.0 - a * a, 0.0)) + length / 2 * abs(a)
                for a in rotate(quat, (0.0, 0.0, 1.0))
            )
            return x, y, z
        case Sphere(radius=radius):
            return radius, radius, radius


def size_of(robot: Robot) -> Size:
    """Return the size of a robot, from the solids of ``model.statics.occupied_space``."""
    tree = tree_of(robot)
    extents = _Extents(robot)
    boxes: list[tuple[str, Vec3, Vec3]] = []
    for name, solids in solids_of(robot).items():
        for shape, pose, _ in solids:
            place = tree.pose[name] * pose
            box = extents.of(shape, place.quat)
            if box is not None:
                boxes.append((name, add(place.xyz, box[0]), add(place.xyz, box[1])))
    lower = _corner(min, (box[1] for box in boxes))
    upper = _corner(max, (box[2] for box in boxes))
    rolling = rolling_links(tree, with_ground_contacts(robot).wheels)
    lowest = min(
        (box for box in boxes if box[0] not in rolling), key=lambda box: box[1][2], default=None
    )
    return Size(
        length=upper[0] - lower[0],
        width=upper[1] - lower[1],
        height=upper[2],
        lower=lower,
        upper=upper,
        wheelbase=_spread(wheel.x for wheel in robot.wheels),
        track=_spread(wheel.y for wheel in robot.wheels),
        ground_clearance=lowest[1][2] if lowest is not None else None,
        lowest_module=tree.links[lowest[0]].module if lowest is not None else "",
        meshes_left_out=tuple(extents.left_out),
    )


def _corner(choose: Callable[[list[float]], float], corners: Iterable[Vec3]) -> Vec3:
    points = list(corners) or [(0.0, 0.0, 0.0)]
    x, y, z = (choose(list(values)) for values in zip(*points, strict=True))
    return x, y, z


def _spread(values: Iterable[float]) -> float | None:
    """Return the difference of the largest and the smallest value, or ``None`` for less than a
    millimetre."""
    ordered = sorted(values)
    spread = ordered[-1] - ordered[0] if ordered else 0.0
    return spread if spread >= _SMALLEST_DISTANCE else None


def rolling_links(tree: JointTree, wheels: Iterable[Wheel]) -> set[str]:
    """Return the names of the links that turn with a wheel, such as tyre and hub."""
    names: set[str] = set()
    for wheel in wheels:
        names.update(tree.links_below(tree.joints[wheel.spin_joint].child))
    return names
