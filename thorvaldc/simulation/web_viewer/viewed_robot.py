"""One robot in the data of the 3D viewer: its links, joints, frames, ports and meshes."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from thorvaldc.compiler.modules.mounting import MountingPort
from thorvaldc.model import Joint, MeshShape, Pose, Robot, Shape
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.simulation.pictures.surfaces import is_closed, surface

MeshData = dict[str, Any]
"""Points and triangles of a mesh in base64, and whether it is the surface of a closed body."""
MeshCache = dict[tuple[Shape, str], MeshData]
"""Meshes by shape and hash of the mesh file."""


class Shapes:
    """The triangle meshes of all visual shapes.  Equal shapes share one mesh."""

    def __init__(self, cache: MeshCache) -> None:
        self.meshes: list[MeshData] = []
        self._cache = cache
        self._indices: dict[tuple[Shape, str], int] = {}

    def index(self, robot: Robot, shape: Shape) -> int:
        content = ""
        if isinstance(shape, MeshShape):
            content = next(mesh.sha256 for mesh in robot.meshes if mesh.name == shape.mesh)
        key = (shape, content)
        if key not in self._indices:
            if key not in self._cache:
                points, faces = surface(robot, shape)
                self._cache[key] = {
                    "points": base64_of(points.astype("<f4")),
                    "faces": base64_of(faces.astype("<u4")),
                    "closed": is_closed(points, faces),
                }
            self._indices[key] = len(self.meshes)
            self.meshes.append(self._cache[key])
        return self._indices[key]


def base64_of(array: Any) -> str:
    """Returns the bytes of an array in base64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 9) for value in values]


def pose_values(pose: Pose) -> list[float]:
    """Returns a pose as [x, y, z, qw, qx, qy, qz], rounded."""
    return _rounded((*pose.xyz, *pose.quat))


def robot_data(robot: Robot, shapes: Shapes, ports: Sequence[MountingPort]) -> dict[str, Any]:
    """Returns the data of a robot that do not depend on the pose of the robot."""
    driven = sum(1 for wheel in robot.wheels if wheel.driven)
    steered = sum(1 for wheel in robot.wheels if wheel.steered)
    tree = tree_of(robot)
    links = tree.links_below(robot.links[0].name)  # parents first: the page computes poses so
    return {
        "facts": f"{robot.inertial.mass:.1f} kg, {len(robot.wheels)} wheels"
        f" ({driven} driven, {steered} steered)",
        "links": [
            {
                "name": link.name,
                "module": link.module,
                "mass": 0.0 if link.inertial is None else round(link.inertial.mass, 6),
                "visuals": [
                    {
                        "shape": shapes.index(robot, visual.shape),
                        "pose": pose_values(visual.pose),
                        "color": _rounded(visual.color),
                    }
                    for visual in link.visuals
                ],
            }
            for link in robot.links
        ],
        "joints": [_joint(tree.parent_joint[link]) for link in links[1:]],
        "frames": [
            *({"name": s.name, "kind": "sensor", "link": s.link} for s in robot.sensors),
            *({"name": link.name, "kind": "link", "link": link.name} for link in robot.links),
            *(
                {
                    "name": p.name,
                    "kind": "port",
                    "link": p.link,
                    "pose": pose_values(p.pose),
                    "note": "taken" if p.carries else "free",
                }
                for p in ports
            ),
        ],
        "ports": [{"name": p.name, "kind": p.kind, "carries": list(p.carries)} for p in ports],
        "nodes": [
            {
                "bus": bus.name,
                "name": node.name,
                "module": node.module,
                "id": node.id,
                "serial": node.serial,
            }
            for bus in robot.buses
            for node in bus.nodes
        ],
    }


def _joint(joint: Joint) -> dict[str, Any]:
    lower, upper = joint.lower, joint.upper
    if joint.type == "continuous" or lower is None or upper is None:
        lower, upper = -math.pi, math.pi
    value: dict[str, Any] = {
        "name": joint.name,
        "type": joint.type,
        "parent": joint.parent,
        "child": joint.child,
        "pose": pose_values(joint.pose),
        "axis": _rounded(joint.axis),
        "lower": lower,
        "upper": upper,
    }
    if joint.mimic is not None:
        value["mimic"] = {
            "joint": joint.mimic.joint,
            "multiplier": joint.mimic.multiplier,
            "offset": joint.mimic.offset,
        }
    return value
