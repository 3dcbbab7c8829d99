"""GNSS receivers."""

from __future__ import annotations

import math
from dataclasses import dataclass


from thorvaldc.model.sensor_numbers import WORLD_ORIGIN
from thorvaldc.simulation.sensors.simulated_sensor import (
    Array,
    Measurement,
    SeenScene,
    SimulatedSensor,
)

_EQUATOR = 6378137.0
"""Semi-major axis of the ellipsoid WGS 84 in m."""
_FLATTENING = 1.0 / 298.257223563
_SQUARED = _FLATTENING * (2.0 - _FLATTENING)
"""Square of the first eccentricity."""


@dataclass(frozen=True, slots=True)
class Fix(Measurement):
    """A position of a GNSS antenna.

    - ``latitude``, ``longitude``: in degrees, on WGS 84.
    - ``altitude``: height above the ellipsoid in m.
    - ``variance``: variance of each of east, north and up in m^2, by the numbers of the module.
    """

    latitude: float
    longitude: float
    altitude: float
    variance: float


class Gnss(SimulatedSensor):
    """A GNSS receiver with its antenna at the measurement frame.

    The share ``wander`` of the variance of a fix changes slowly, and the rest is white.  The stated
    variance is that of a fix, as receivers state it.
    """

    def measure(self, seen: SeenScene) -> Fix:
        values = self.numbers
        accuracy, share = values["accuracy"], values["wander"]
        slow = self._slow_errors(
            accuracy * math.sqrt(share), values["wander_time"], seen.data.time
        )
        white = self._errors(accuracy * math.sqrt(1.0 - share), 3)
        position, _ = self.pose(seen)
        place = geodetic(seen.level @ position + slow + white)
        return Fix(*self._common(seen), *place, accuracy**2)


def geodetic(position: Array) -> tuple[float, float, float]:
    """Returns latitude (deg), longitude (deg) and height (m) of a position (3) east, north and up
    of ``WORLD_ORIGIN`` in m.

    The position is a vector in the tangent plane, as in Gazebo.  Source of the formulas: Bowring,
    "Transformation from spatial to geographical coordinates" (1976), repeated until the latitude
    stays the same.
    """
    latitude, longitude = (math.radians(angle) for angle in WORLD_ORIGIN[:2])
    east, north, up = (float(value) for value in position)
    sin, cos = math.sin(latitude), math.cos(latitude)
    normal = _EQUATOR / math.sqrt(1.0 - _SQUARED * sin * sin)
    # In the meridian plane of the origin: distance from the axis, and along the axis.
    across = (normal + WORLD_ORIGIN[2]) * cos - sin * north + cos * up
    along = (normal * (1.0 - _SQUARED) + WORLD_ORIGIN[2]) * sin + cos * north + sin * up
    distance = math.hypot(across, east)
    longitude += math.atan2(east, across)
    reduced = math.atan2(along, distance * (1.0 - _FLATTENING))
    minor = _EQUATOR * (1.0 - _FLATTENING)
    for _ in range(3):
        latitude = math.atan2(
            along + _SQUARED / (1.0 - _SQUARED) * minor * math.sin(reduced) ** 3,
            distance - _SQUARED * _EQUATOR * math.cos(reduced) ** 3,
        )
        reduced = math.atan((1.0 - _FLATTENING) * math.tan(latitude))
    sin, cos = math.sin(latitude), math.cos(latitude)
    normal = _EQUATOR / math.sqrt(1.0 - _SQUARED * sin * sin)
    height = distance * cos + along * sin - normal * (1.0 - _SQUARED * sin * sin)
    return math.degrees(latitude), math.degrees(longitude), height
