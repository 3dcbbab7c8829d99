"""The data that the 3D viewer draws: a robot or a fleet with its world, as one JSON object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from thorvaldc.compiler.modules.mounting import MountingPort
from thorvaldc.model import Fleet, Pose, Robot
from thorvaldc.simulation.web_viewer.viewed_robot import MeshCache, Shapes, pose_values, robot_data
from thorvaldc.simulation.web_viewer.viewed_world import world_data

PortsOf = Callable[[Robot], Sequence[MountingPort]]


def page_data(
    model: Robot | Fleet, cache: MeshCache | None = None, ports: PortsOf | None = None
) -> dict[str, Any]:
    """Returns the data of a robot or a fleet that the viewer draws, as a JSON object.

    Lengths are in m, angles in rad, masses in kg, and quaternions in the order wxyz.  The model
    must contain the data of the meshes.  Robots with an equal design share one copy of the design
    data.

    The function takes meshes from ``cache`` and adds new ones to it.  ``ports`` returns the
    mounting ports of a robot.
    """
    shapes = Shapes({} if cache is None else cache)
    designs: list[dict[str, Any]] = []
    robots: list[dict[str, Any]] = []
    placements = (
        [(p.name, p.pose, p.robot) for p in model.placements]
        if isinstance(model, Fleet)
        else [(model.name, Pose(), model)]
    )
    for name, pose, robot in placements:
        design = robot_data(robot, shapes, ports(robot) if ports is not None else ())
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
        first = model.placements[0].robot  # fixed bodies have no meshes: any robot will do
        starts = tuple(p.pose for p in model.placements)
        data["world"] = world_data(model.world, starts, lambda shape: shapes.index(first, shape))
    return data
