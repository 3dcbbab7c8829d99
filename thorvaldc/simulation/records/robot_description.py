"""The robot in an MCAP file: its URDF with the meshes inside, and the frames of its links.

Foxglove resolves ``package://`` only with a ROS installation.  It fetches other URLs of meshes with
the browser's ``fetch`` (``ThreeDeeRender/ModelCache.ts`` in its open-source fork Lichtblick), which
reads ``data:`` URLs.  It turns STL and OBJ files by its setting "Mesh up axis", at first "Y-up",
but not glTF files, whose standard has y up.
"""

from __future__ import annotations

import base64
import functools
import math
import re
from collections.abc import Sequence
from itertools import chain
from typing import Any

from thorvaldc.backends.urdf import MESHES, urdf_text
from thorvaldc.backends.xml_writer import escape
from thorvaldc.compiler.shapes.mesh_formats import mesh_triangles
from thorvaldc.model import Robot, Vec3
from thorvaldc.model.spatial import Quat, quat_multiply
from thorvaldc.model.statics.joint_tree import follow, tree_of
from thorvaldc.model.statics.standing_pose import solve_statics

Transform = tuple[float, ...]
"""Positions (m) and quaternions xyzw of frames in their parent frames."""


def urdf_with_meshes(robot: Robot) -> str:
    """Returns the URDF of a robot with its meshes as ``data:`` URLs of binary glTF files.

    The model must contain the data of the meshes.
    """
    urls = {escape(mesh.name): _glb_url(mesh.name, mesh.data) for mesh in robot.meshes}
    pattern = rf'filename="{re.escape(MESHES)}/([^"]*)"'
    return re.sub(pattern, lambda match: f'filename="{urls[match[1]]}"', urdf_text(robot))


@functools.lru_cache(maxsize=256)
def _glb_url(name: str, data: bytes) -> str:
    """Returns a mesh file as the ``data:`` URL of a binary glTF file.

    Each triangle has corners of its own, with its normal, so that its edges stay sharp.
    """
    import numpy as np
    from trimesh import Trimesh

    points = chain.from_iterable(chain.from_iterable(mesh_triangles(name, data)))
    corners = np.fromiter(points, np.float64).reshape(-1, 3)
    corners = corners[:, (0, 2, 1)] * (1.0, 1.0, -1.0)  # from z up to y up
    mesh: Any = Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    # Without normals of corners, trimesh computes means that need scipy, and logs if it is missing.
    mesh.vertex_normals = np.repeat(mesh.face_normals, 3, axis=0)
    content = mesh.export(file_type="glb", include_normals=True)
    return "data:model/gltf-binary;base64," + base64.b64encode(content).decode("ascii")


class LinkFrames:
    """The frames of all links of a robot in their parent links, with names as in the URDF.

    - ``fixed``: transform of each frame (parent, child) that does not move in a record.  Springs,
      casters and other joints without readings have the positions of the standing robot.
    - ``moving``: the frames that the joint readings turn.
    """

    def __init__(self, robot: Robot, joints: Sequence[str]) -> None:
        """``joints``: names of the joints with readings."""
        self.fixed: dict[tuple[str, str], Transform] = {}
        self.moving: list[tuple[str, str]] = []
        # Index of the reading, ratio and offset of the coupling to it, and three constants.  The
        # rotation A and then the one by the angle q about n is A (cos(q/2), sin(q/2) n)
        # = cos(q/2) A + sin(q/2) B, with B = A (0, n).
        self._turns: list[tuple[int, float, float, Vec3, Quat, Quat]] = []
        tree = tree_of(robot).at(solve_statics(robot).positions)
        for joint in robot.joints:
            frame = (robot.prefix + joint.parent, robot.prefix + joint.child)
            leader = follow(joint, tree.joints)
            if leader is not None and leader.joint.name in joints and joint.type != "prismatic":
                self.moving.append(frame)
                index, a = joints.index(leader.joint.name), joint.pose.quat
                b = quat_multiply(a, (0.0, *joint.axis))
                self._turns.append((index, leader.ratio, leader.offset, joint.pose.xyz, a, b))
            else:
                pose = tree.pose[joint.parent].inverse() * tree.pose[joint.child]
                self.fixed[frame] = (*pose.xyz, *pose.quat[1:], pose.quat[0])

    def moving_numbers(self, readings: Sequence[float]) -> Transform:
        """Returns the numbers of the transforms of the moving frames, one after another.

        ``readings``: positions of the joints in rad, nan for one that is not known.
        """
        numbers: list[float] = []
        for index, ratio, offset, xyz, (aw, ax, ay, az), (bw, bx, by, bz) in self._turns:
            reading = readings[index]
            q = (0.0 if math.isnan(reading) else ratio * reading) + offset
            c, s = math.cos(q / 2), math.sin(q / 2)
            numbers += (*xyz, c * ax + s * bx, c * ay + s * by, c * az + s * bz, c * aw + s * bw)
        return tuple(numbers)
