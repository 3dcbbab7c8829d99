"""Computes the facts about a robot from its model."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from thorvaldc.model import quantities as si
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
from thorvaldc.model.statics.unpowered import StandingSlopes, standing_slopes


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """Facts about a robot, in SI units and angles in rad, with all joints at position 0.

    - ``mass``: mass of the robot in kg.
    - ``modules``: mass by module.
    - ``mass_sources``: mass by kind of source.
    - ``center_of_mass``: position in ``base_link`` in m.
    - ``soil``: ``None`` for a robot without wheels.
    - ``slopes``: ``None`` for a robot without driven wheels or one that does not stand.
    - ``standing``: ``None`` for a robot that does not stand.
    """

    name: str
    description: str
    size: Size
    mass: si.Kilograms
    modules: tuple[ModuleMass, ...]
    mass_sources: tuple[MassShare, ...]
    center_of_mass: si.Position
    wheels: tuple[WheelLoad, ...]
    soil: SoilLoad | None
    stability: Stability
    driving: Driving
    slopes: Slopes | None
    standing: StandingSlopes | None
    energy: Energy
    buses: tuple[BusFacts, ...]
    wiring: tuple[Wire, ...]
    bill: tuple[BillRow, ...]
    purchase: PurchaseFacts


_SECTIONS: dict[str, Callable[[Robot], Any]] = {
    "name": lambda robot: robot.name,
    "description": lambda robot: robot.description,
    "size": size_of,
    "mass": lambda robot: robot.inertial.mass,
    "modules": masses_of,
    "mass_sources": lambda robot: mass_by_source(masses_of(robot)),
    "center_of_mass": lambda robot: robot.inertial.com,
    "wheels": wheel_loads_of,
    "soil": soil_load_of,
    "stability": stability_of,
    "driving": driving_of,
    "slopes": slopes_of,
    "standing": standing_slopes,
    "energy": energy_of,
    "buses": buses_of,
    "wiring": wiring_of,
    "bill": lambda robot: bill_of(masses_of(robot)),
    "purchase": purchase_of,
}


@once_per_model
def robot_facts(robot: Robot) -> RobotFacts:
    """Return the facts about a robot."""
    return RobotFacts(**fact_sections(robot, _SECTIONS))


def fact_sections(robot: Robot, names: Iterable[str]) -> dict[str, Any]:
    """Return some attributes of ``RobotFacts`` by name, and compute only these.

    Raises ``KeyError`` if ``RobotFacts`` has no such attribute.
    """
    return {name: _SECTIONS[name](robot) for name in names}


def fact_quantity(path: str) -> si.Quantity:
    """Return the quantity of a fact, such as a length for ``size.width``.

    ``path`` : keys of the fact in the JSON values of ``facts_document``, joined by dots.
    """
    return si.quantity_at(RobotFacts, path.split(".")) or si.NUMBER
