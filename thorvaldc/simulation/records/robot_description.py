"""The robot in an MCAP file: its URDF with the meshes inside, and the frames of its links.

A viewer of MCAP files has one file and no ROS package, so that it cannot resolve ``package://``.
Foxglove fetches the URL of a mesh with the browser's ``fetch`` (``ThreeDeeRender/ModelCache.ts`` in
its open-source fork Lichtblick), which reads ``data:`` URLs without a server.  It turns STL and OBJ
files by its setting "Mesh up axis", which is "Y-up" at first, but takes the axes of glTF files from
their standard (y up).  The meshes are therefore binary glTF files in ``data:`` URLs.
"""

from __future__ import annotations

import base64
import functools
import json
import math
import re
import struct
from collections.abc import Callable, Sequence
from itertools import chain

from thorvaldc.backends.urdf import MESHES, urdf_text
from thorvaldc.backends.xml_writer import escape
from thorvaldc.compiler.shapes.mesh_formats import mesh_triangles
from thorvaldc.model import Joint, Robot
from thorvaldc.model.spatial import quat_multiply
from thorvaldc.model.statics.joint_tree import follow
from thorvaldc.model.statics.standing_pose import solve_statics

Transform = tuple[float, ...]
"""Position (m) and quaternion xyzw of a frame in its parent frame."""


def self_contained_urdf(robot: Robot) -> str:
    """Returns the URDF of a robot with its meshes as ``data:`` URLs of binary glTF files.

    The model must contain the data of the meshes.
    """
    urls = {escape(mesh.name): _glb_url(mesh.name, mesh.data) for mesh in robot.meshes}
    pattern = rf'filename="{re.escape(MESHES)}/([^"]*)"'
    return re.sub(pattern, lambda match: f'filename="{urls[match[1]]}"', urdf_text(robot))


@functools.lru_cache(maxsize=256)
def _glb_url(name: str, data: bytes) -> str:
    """Returns a mesh file as the ``data:`` URL of a binary glTF file.

    Each triangle has corners of its own, with the normal vector of the triangle.  Section "Binary
    glTF Layout" of the specification of glTF 2.0 has the header and the two chunks.
    """
    import numpy as np

    points = chain.from_iterable(mesh_triangles(name, data))
    triangles = np.fromiter(chain.from_iterable(points), np.float64).reshape(-1, 3, 3)
    triangles = triangles[:, :, (0, 2, 1)] * (1.0, 1.0, -1.0)  # from z up to y up
    a, b, c = triangles.swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    corners = triangles.reshape(-1, 3).astype("<f4")
    arrays = corners.tobytes() + normals.repeat(3, axis=0).astype("<f4").tobytes()
    size = corners.nbytes
    accessor = {"componentType": 5126, "count": len(corners), "type": "VEC3"}  # of float32
    bounds = {"min": corners.min(axis=0).tolist(), "max": corners.max(axis=0).tolist()}
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
        "accessors": [{"bufferView": 0, **accessor, **bounds}, {"bufferView": 1, **accessor}],
        "bufferViews": [{"buffer": 0, "byteOffset": i * size, "byteLength": size} for i in (0, 1)],
        "buffers": [{"byteLength": 2 * size}],
    }
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    content = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + 2 * size)
    content += struct.pack("<I4s", len(text), b"JSON") + text
    content += struct.pack("<I4s", 2 * size, b"BIN\0") + arrays
    return "data:model/gltf-binary;base64," + base64.b64encode(content).decode("ascii")


class LinkFrames:
    """The frames of all links of a robot in their parent links, with names as in the URDF.

    - ``fixed``: tuples (parent, child) of the frames that do not move in a record.  Joints that no
      joint reading moves, such as springs and casters, have the positions of the standing robot.
    - ``fixed_transforms``: the transform of each fixed frame.
    - ``moving``: tuples (parent, child) of the frames that the joint readings move.
    """

    def __init__(self, robot: Robot, joints: Sequence[str]) -> None:
        """``joints``: names of the joints with readings."""
        self.fixed: list[tuple[str, str]] = []
        self.fixed_transforms: list[Transform] = []
        self.moving: list[tuple[str, str]] = []
        # Number of the reading, ratio and offset of the coupling to it, motion of the joint.
        self._motions: list[tuple[int, float, float, Callable[[float], Transform]]] = []
        standing = solve_statics(robot).positions
        by_name = {joint.name: joint for joint in robot.joints}
        numbers = {name: number for number, name in enumerate(joints)}
        for joint in robot.joints:
            frame = (robot.prefix + joint.parent, robot.prefix + joint.child)
            leader = follow(joint, by_name)
            if leader is not None and leader.joint.name in numbers:
                number = numbers[leader.joint.name]
                self.moving.append(frame)
                self._motions.append((number, leader.ratio, leader.offset, _motion(joint)))
            else:
                self.fixed.append(frame)
                self.fixed_transforms.append(_motion(joint)(standing.get(joint.name, 0.0)))

    def moving_numbers(self, readings: Sequence[float]) -> list[float]:
        """Returns the numbers of the transforms of the moving frames, one after another.

        ``readings``: positions of the joints in rad.
        """
        numbers: list[float] = []
        for reading, ratio, offset, motion in self._motions:
            numbers += motion(ratio * readings[reading] + offset)
        return numbers


def _motion(joint: Joint) -> Callable[[float], Transform]:
    """Returns the function from the position of a joint (rad or m) to the pose of its child.

    The rotation by the angle q about the axis n after the rotation A is the quaternion product
    A (cos(q/2), sin(q/2) n) = cos(q/2) A + sin(q/2) B, with the constant B = A (0, n).
    """
    x, y, z = joint.pose.xyz
    aw, ax, ay, az = joint.pose.quat
    if joint.type in ("fixed", "prismatic"):
        dx, dy, dz = joint.pose.rotate(joint.axis)
        return lambda q: (x + q * dx, y + q * dy, z + q * dz, ax, ay, az, aw)
    bw, bx, by, bz = quat_multiply(joint.pose.quat, (0.0, *joint.axis))

    def turned(q: float) -> Transform:
        c, s = math.cos(q / 2), math.sin(q / 2)
        return (x, y, z, c * ax + s * bx, c * ay + s * by, c * az + s * bz, c * aw + s * bw)

    return turned
