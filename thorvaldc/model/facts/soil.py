"""The load of the wheels on soft soil."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.robot import Robot


@dataclass(frozen=True, slots=True)
class SoilLoad:
    """The largest load and pressure of a wheel on level ground.

    The nominal ground pressure of a wheel is its load over the product of its radius and width. It
    compares wheels on soil in which they sink; on firm ground the contact area is smaller.

    - ``wheel_load``: largest wheel load in N.
    - ``pressure``: largest nominal ground pressure in Pa, or ``None`` for a wheel without a width.
    """

    wheel_load: si.Newtons
    pressure: si.Pascals | None


def soil_load_of(robot: Robot) -> SoilLoad | None:
    """Return the load of a robot on the soil, or ``None`` for a robot without wheels."""
    if not robot.wheels:
        return None
    areas = [wheel.radius * wheel.width for wheel in robot.wheels]
    pressures = [
        wheel.load / area for wheel, area in zip(robot.wheels, areas, strict=True) if area > 0.0
    ]
    return SoilLoad(
        wheel_load=max(wheel.load for wheel in robot.wheels),
        pressure=max(pressures) if len(pressures) == len(robot.wheels) else None,
    )
