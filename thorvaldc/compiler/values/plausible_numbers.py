"""Finds numbers without a unit that were probably meant in another unit, such as mm."""

from __future__ import annotations

import math

from thorvaldc.compiler.source.units import parse_quantity

_USUAL: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "length": (0.0, 20.0, ("mm",)),
    "mass": (0.0, 5_000.0, ("g",)),
    "time": (0.0, 60.0, ("ms",)),
    "velocity": (0.0, 30.0, ("mm/s", "km/h")),
    "acceleration": (0.0, 100.0, ("mm/s^2",)),
    "angular_velocity": (0.0, 2_000.0, ("rpm",)),
    "torque": (0.0, 20_000.0, ("N mm",)),
    "voltage": (0.0, 1_500.0, ("mV",)),
    "current": (0.0, 2_000.0, ("mA",)),
    "density": (20.0, math.inf, ("g/cm^3",)),
}
"""Least and largest usual value on a robot in SI units, and the units of other numbers.

The largest values are above those of large field robots, with a length of 10 m and a mass of 2 t.
"""


_USUAL_IN_SCENARIO: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "length": (0.0, 1_000.0, ("mm",)),
    "time": (0.0, 14_400.0, ("ms",)),
    "velocity": (0.0, 30.0, ("mm/s", "km/h")),
    "angular_velocity": (0.0, 20.0, ("deg/s", "rpm")),
    "energy": (0.0, math.inf, ()),
}
"""Values as in ``_USUAL`` of numbers in fleets and scenarios: places, commands and durations."""


def probable_unit(value: float, quantity: str, *, on_robot: bool = True) -> str:
    """Returns the unit in which a number was probably meant, or an empty text if it is SI.

    - ``value``: number without a unit, which the compiler takes in SI units.
    - ``quantity``: kind of quantity, such as ``length``.
    - ``on_robot``: whether the number describes a robot, and not a fleet or scenario.
    """
    table = _USUAL if on_robot else _USUAL_IN_SCENARIO
    least, largest, units = table.get(quantity, (0.0, math.inf, ()))
    size = abs(value)
    if size == 0.0 or least <= size <= largest:
        return ""
    usual = (u for u in units if least <= parse_quantity(f"{size!r} {u}", quantity) <= largest)
    return next(usual, "")
