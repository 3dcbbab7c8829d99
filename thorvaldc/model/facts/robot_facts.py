"""Computes the facts about a robot from its model, and converts them to JSON values."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from thorvaldc.diagnostics.html_view import HtmlView
from thorvaldc.model import Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.facts import electrics, masses
from thorvaldc.model.facts import stability as standing_facts
from thorvaldc.model.facts.driving import Driving, Slopes, driving_of, slopes_of
from thorvaldc.model.facts.size import Size, size_of
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.slope import StandingSlopes, standing_slopes


@dataclass(frozen=True, slots=True)
class RobotFacts(HtmlView):
    """Facts about a robot, in SI units and angles in rad, with all joints at position 0.

    - ``mass``: mass of the robot in kg.
    - ``modules``: mass by module.
    - ``mass_sources``: mass by kind of source.
    - ``center_of_mass``: position in ``base_link`` in m.
    - ``soil``: ``None`` for a robot without wheels.
    - ``slopes``: ``None`` for a robot without driven wheels or one that does not stand.
    - ``standing``: ``None`` for a robot that does not stand.
    """

    html_view = "thorvaldc.model.facts.fact_page:facts_html"

    name: str
    description: str
    size: Size
    mass: si.Kilograms
    modules: tuple[masses.ModuleMass, ...]
    mass_sources: tuple[masses.MassShare, ...]
    center_of_mass: si.Position
    wheels: tuple[standing_facts.WheelLoad, ...]
    soil: standing_facts.SoilLoad | None
    stability: standing_facts.Stability
    driving: Driving
    slopes: Slopes | None
    standing: StandingSlopes | None
    energy: electrics.Energy
    buses: tuple[electrics.BusFacts, ...]
    wiring: tuple[electrics.Wire, ...]
    bill: tuple[masses.BillRow, ...]
    purchase: masses.PurchaseFacts


_SECTIONS: dict[str, Callable[[Robot], Any]] = {
    "name": lambda robot: robot.name,
    "description": lambda robot: robot.description,
    "size": size_of,
    "mass": lambda robot: robot.inertial.mass,
    "modules": masses.masses_of,
    "mass_sources": lambda robot: masses.mass_by_source(masses.masses_of(robot)),
    "center_of_mass": lambda robot: robot.inertial.com,
    "wheels": standing_facts.wheel_loads_of,
    "soil": standing_facts.soil_load_of,
    "stability": standing_facts.stability_of,
    "driving": driving_of,
    "slopes": slopes_of,
    "standing": standing_slopes,
    "energy": electrics.energy_of,
    "buses": electrics.buses_of,
    "wiring": electrics.wiring_of,
    "bill": lambda robot: masses.bill_of(masses.masses_of(robot)),
    "purchase": masses.purchase_of,
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


def facts_document(facts: Any) -> dict[str, Any]:
    """Return facts as JSON values, with the names of the fields as keys.

    ``facts`` is a ``RobotFacts`` or a part of it.
    All values are in SI units and angles in rad, rounded to 12 significant digits.
    """
    return {
        field.name: json_value(getattr(facts, field.name)) for field in dataclasses.fields(facts)
    }


def json_value(value: Any) -> Any:
    """Return one fact, or a part of a ``RobotFacts``, as a JSON value, as ``facts_document``."""
    if dataclasses.is_dataclass(value):
        return facts_document(value)
    if isinstance(value, tuple):
        if value and all(_is_pair(item) for item in value):
            return {key: json_value(item) for key, item in value}
        return [json_value(item) for item in value]
    return clean(value) if isinstance(value, float) else value


def _is_pair(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str)
