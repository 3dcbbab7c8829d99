"""Creates a web page that shows a robot or a fleet in 3D.

The web page is a single file that contains all data of the model.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from thorvaldc.compiler.modules.mounting_ports import MountingPort
from thorvaldc.model import Fleet, MeshShape, Robot
from thorvaldc.model.robot import Joint, Shape
from thorvaldc.model.spatial import Pose
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.simulation.pictures.surfaces import is_closed, surface

PLACEHOLDER = "/*DATA*/"
"""Placeholder in the template that the data of the model replaces."""


def robot_page(model: Robot | Fleet, template: str, before: Robot | Fleet | None = None) -> str:
    """Returns the web page ``template`` with the data of the model as JSON.

    The page also shows the model ``before``, as a translucent shape at the same place.

    Lengths are in m, angles in rad, masses in kg, and quaternions in the order wxyz.  The model
    must contain the data of the meshes.  Robots with an equal design share one copy of the design
    data.  Raises ``ValueError`` if the template has no placeholder for the data.
    """
    if template.count(PLACEHOLDER) != 1:
        raise ValueError(f"the template must have {PLACEHOLDER} exactly once")
    value = page_data(model)
    if before is not None:
        value["ghost"] = page_data(before)
    # The text `</script` inside the JSON data would end the script element.
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    return template.replace(PLACEHOLDER, text)


MeshData = dict[str, Any]
"""Points and triangles of a mesh in base64, and whether it is the surface of a closed body."""
MeshCache = dict[tuple[Shape, str], MeshData]
"""Meshes by shape and hash of the mesh file."""
PortsOf = Callable[[Robot], Sequence[MountingPort]]


def page_data(
    model: Robot | Fleet, cache: MeshCache | None = None, ports: PortsOf | None = None
) -> dict[str, Any]:
    """Returns the data of a robot or a fleet that the viewer draws, as a JSON object.

    The function takes meshes from ``cache`` and adds new ones to it.  ``ports`` returns the
    mounting ports of a robot.
    """
    shapes = _Shapes({} if cache is None else cache)
    designs: list[dict[str, Any]] = []
    robots: list[dict[str, Any]] = []
    placements = (
        [(p.name, p.pose, p.robot) for p in model.placements]
        if isinstance(model, Fleet)
        else [(model.name, Pose(), model)]
    )
    for name, pose, robot in placements:
        design = _design(robot, shapes, ports(robot) if ports is not None else ())
        if design not in designs:
            designs.append(design)
        robots.append({"name": name, "pose": pose_values(pose), "design": designs.index(design)})
    data: dict[str, Any] = {
        "name": model.name,
        "description": model.description,
        "robots": robots,
        "designs": designs,
        "shapes": shapes.meshes,
    }
    if isinstance(model, Fleet) and model.world is not None:
        from thorvaldc.simulation.pictures.world_page import world_data

        first = model.placements[0].robot  # fixed bodies have no meshes: any robot will do
        starts = tuple(p.pose for p in model.placements)
        data["world"] = world_data(model.world, starts, lambda shape: shapes.index(first, shape))
    return data


class _Shapes:
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


def _design(robot: Robot, shapes: _Shapes, ports: Sequence[MountingPort]) -> dict[str, Any]:
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
