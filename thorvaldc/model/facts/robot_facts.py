"""Computes the facts about a robot from its model."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model.facts.driving import Driving, driving_of
from thorvaldc.model.facts.masses import ModuleMass, masses_of
from thorvaldc.model.facts.size import Size, size_of
from thorvaldc.model.facts.stability import Stability, WheelLoad, stability_of, wheel_loads_of
from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Robot
from thorvaldc.model.spatial import Vec3


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """Facts about a robot, in SI units and angles in rad, with all joints at position 0.

    - ``mass``: mass of the robot in kg.
    - ``modules``: mass by module.
    - ``center_of_mass``: position in ``base_link`` in m.
    """

    name: str
    description: str
    size: Size
    mass: float
    modules: tuple[ModuleMass, ...]
    center_of_mass: Vec3
    wheels: tuple[WheelLoad, ...]
    stability: Stability
    driving: Driving


@once_per_model
def robot_facts(robot: Robot) -> RobotFacts:
    """Return the facts about a robot."""
    return RobotFacts(
        name=robot.name,
        description=robot.description,
        size=size_of(robot),
        mass=robot.inertial.mass,
        modules=masses_of(robot),
        center_of_mass=robot.inertial.com,
        wheels=wheel_loads_of(robot),
        stability=stability_of(robot),
        driving=driving_of(robot),
    )
