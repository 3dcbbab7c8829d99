"""The shapes of links: frozen dataclasses of the robot model."""

from __future__ import annotations

from dataclasses import dataclass, field

from thorvaldc.model import quantities as si
from thorvaldc.model.spatial import Pose, Vec3


@dataclass(frozen=True, slots=True)
class Box:
    """A box, centred on the origin of its frame. ``size`` has the full edge lengths of the box
    along x, y and z in m."""

    size: si.Position


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder along the z axis, centred on the origin of its frame, with radius and full length
    in m."""

    radius: si.Metres
    length: si.Metres


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere, centred on the origin of its frame, with the radius in m."""

    radius: si.Metres


@dataclass(frozen=True, slots=True)
class MeshShape:
    """A collision or visual shape from a mesh file of the robot.

    - ``mesh``: name of a mesh in ``Robot.meshes``.
    - ``scale``: scale factors along x, y and z.
    """

    mesh: str
    scale: Vec3 = (1.0, 1.0, 1.0)


Shape = Box | Cylinder | Sphere | MeshShape


@dataclass(frozen=True, slots=True)
class Mesh:
    """A mesh file of a build, in the format STL or OBJ.

    URDF readers and MuJoCo both read STL and OBJ files. The compiler converts mesh files in other
    formats to STL or OBJ.

    - ``name``: name of the mesh file in the build folder.
    - ``data``: bytes of the mesh file. The JSON text of the model omits ``data``.
    - ``sha256``: hash of the bytes (hexadecimal).
    """

    name: str
    sha256: str
    data: bytes = field(default=b"", compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Visual:
    """A visual shape of a link.

    - ``pose``: pose of the shape in the link frame.
    - ``color``: red, green, blue and opacity, each 0 to 1.
    """

    shape: Shape
    pose: Pose
    color: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Collision:
    """A collision shape of a link. ``pose`` is the pose of the shape in the link frame."""

    shape: Shape
    pose: Pose
