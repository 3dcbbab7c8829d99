"""Computes the facts about a robot from its model."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model.facts.driving import Driving, driving_of
from thorvaldc.model.facts.electrics import BusFacts, Wire, buses_of, wiring_of
from thorvaldc.model.facts.energy import Energy, energy_of
from thorvaldc.model.facts.masses import (
    BillRow,
    MassShare,
    ModuleMass,
    bill_of,
    mass_by_source,
    masses_of,
)
from thorvaldc.model.facts.purchase import PurchaseFacts, purchase_of
from thorvaldc.model.facts.size import Size, size_of
from thorvaldc.model.facts.slopes import Slopes, slopes_of
from thorvaldc.model.facts.soil import SoilLoad, soil_load_of
from thorvaldc.model.facts.stability import Stability, WheelLoad, stability_of, wheel_loads_of
from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Robot
from thorvaldc.model.spatial import Vec3


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """Facts about a robot, in SI units and angles in rad, with all joints at position 0.

    - ``mass``: mass of the robot in kg.
    - ``modules``: mass by module.
    - ``mass_sources``: mass by kind of source.
    - ``center_of_mass``: position in ``base_link`` in m.
    - ``soil``: ``None`` for a robot without wheels.
    - ``slopes``: ``None`` for a robot without driven wheels or one that does not stand.
    """

    name: str
    description: str
    size: Size
    mass: float
    modules: tuple[ModuleMass, ...]
    mass_sources: tuple[MassShare, ...]
    center_of_mass: Vec3
    wheels: tuple[WheelLoad, ...]
    soil: SoilLoad | None
    stability: Stability
    driving: Driving
    slopes: Slopes | None
    energy: Energy
    buses: tuple[BusFacts, ...]
    wiring: tuple[Wire, ...]
    bill: tuple[BillRow, ...]
    purchase: PurchaseFacts


@once_per_model
def robot_facts(robot: Robot) -> RobotFacts:
    """Return the facts about a robot."""
    modules = masses_of(robot)
    return RobotFacts(
        name=robot.name,
        description=robot.description,
        size=size_of(robot),
        mass=robot.inertial.mass,
        modules=modules,
        mass_sources=mass_by_source(modules),
        center_of_mass=robot.inertial.com,
        wheels=wheel_loads_of(robot),
        soil=soil_load_of(robot),
        stability=stability_of(robot),
        driving=driving_of(robot),
        slopes=slopes_of(robot),
        energy=energy_of(robot),
        buses=buses_of(robot),
        wiring=wiring_of(robot),
        bill=bill_of(modules),
        purchase=purchase_of(robot),
    )
