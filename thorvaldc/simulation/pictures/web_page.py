"""A web page to look at a robot or a fleet: one file that loads nothing from elsewhere."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from thorvaldc.model import Fleet, MeshShape, Robot
from thorvaldc.model.robot import Joint, Shape
from thorvaldc.model.spatial import Pose
from thorvaldc.simulation.pictures.visible_shapes import surface

PLACE = "/*DATA*/"
"""Where the template takes the data."""


def page(model: Robot | Fleet, template: str) -> str:
    """The page: ``template`` with what it shows of the model put in as JSON.

    Lengths in m, angles in rad, quaternions wxyz, masses in kg.  The model must carry the
    data of its meshes.  Raises ``ValueError`` where the template has no place for the data.
    """
    if template.count(PLACE) != 1:
        raise ValueError(f"the template has no single {PLACE}")
    shapes = _Shapes()
    designs: list[str] = []
    robots: list[dict[str, Any]] = []
    placed = (
        [(p.name, p.pose, p.robot) for p in model.placements]
        if isinstance(model, Fleet)
        else [(model.name, Pose(), model)]
    )
    for name, pose, robot in placed:
        design = json.dumps(_design(robot, shapes))
        if design not in designs:
            designs.append(design)
        robots.append({"name": name, "pose": _numbers(pose), "design": designs.index(design)})
    value = {
        "name": model.name,
        "description": model.description,
        "robots": robots,
        "designs": [json.loads(design) for design in designs],
        "shapes": shapes.made,
    }
    # In a script element only `<` could end the data.
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    return template.replace(PLACE, text)


class _Shapes:
    """Surfaces, each once."""

    def __init__(self) -> None:
        self.made: list[dict[str, str]] = []
        self._known: dict[tuple[Shape, str], int] = {}

    def number(self, robot: Robot, shape: Shape) -> int:
        content = ""
        if isinstance(shape, MeshShape):
            content = next(mesh.sha256 for mesh in robot.meshes if mesh.name == shape.mesh)
        key = (shape, content)
        if key not in self._known:
            points, faces = surface(robot, shape)
            self._known[key] = len(self.made)
            self.made.append(
                {
                    "points": _packed(points.astype("<f4")),
                    "faces": _packed(faces.astype("<u4")),
                }
            )
        return self._known[key]


def _packed(array: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 9) for value in values]


def _numbers(pose: Pose) -> list[float]:
    return _rounded((*pose.xyz, *pose.quat))


def _design(robot: Robot, shapes: _Shapes) -> dict[str, Any]:
    """What is shown of a robot wherever it stands."""
    driven = sum(wheel.driven for wheel in robot.wheels)
    steered = sum(wheel.steered for wheel in robot.wheels)
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
                        "shape": shapes.number(robot, visual.shape),
                        "pose": _numbers(visual.pose),
                        "color": _rounded(visual.color),
                    }
                    for visual in link.visuals
                ],
            }
            for link in robot.links
        ],
        "joints": [_joint(joint) for joint in _parents_first(robot)],
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
        "pose": _numbers(joint.pose),
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


def _parents_first(robot: Robot) -> list[Joint]:
    children: dict[str, list[Joint]] = {}
    for joint in robot.joints:
        children.setdefault(joint.parent, []).append(joint)
    found: list[Joint] = []
    waiting = [robot.links[0].name]
    while waiting:
        below = children.get(waiting.pop(0), [])
        found += below
        waiting += [joint.child for joint in below]
    return found
