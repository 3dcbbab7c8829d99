"""GNSS receivers."""

from __future__ import annotations

import math

from thorvaldc.model.sensor_numbers import WORLD_ORIGIN
from thorvaldc.simulation.sensors.simulated_sensor import (
    Array,
    Message,
    SimulatedSensor,
    diagonal,
)

_EQUATOR, _FLATTENING = 6378137.0, 1.0 / 298.257223563
"""Semi-major axis of the ellipsoid WGS 84 in m, and its flattening."""
_POLE = _EQUATOR * (1.0 - _FLATTENING)
_SQUARED = _FLATTENING * (2.0 - _FLATTENING)
"""Square of the first eccentricity."""


class Gnss(SimulatedSensor):
    """A GNSS receiver with its antenna at the measurement frame.

    The share ``wander`` of the variance of a fix changes slowly, and the rest is white.  The stated
    variance is that of a fix, as receivers state it.
    """

    def measure(self) -> list[Message]:
        accuracy, share = self.numbers["accuracy"], self.numbers["wander"]
        slow = self._slow_errors(accuracy * math.sqrt(share), self.numbers["wander_time"])
        white = self._errors(accuracy * math.sqrt(1.0 - share), 3)
        position, _ = self.pose()
        latitude, longitude, altitude = geodetic(self.seen.level @ position + slow + white)
        # A fix with corrections of a base station, by the system GPS.
        status = Message("sensor_msgs/msg/NavSatStatus", {"status": 2, "service": 1})
        fix = self._message(
            "NavSatFix",
            status=status,
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=diagonal(accuracy**2),
            position_covariance_type=2,  # the diagonal is known
        )
        return [fix]


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
    reduced = math.atan2(along, distance * (1.0 - _FLATTENING))
    for _ in range(3):
        latitude = math.atan2(
            along + _SQUARED / (1.0 - _SQUARED) * _POLE * math.sin(reduced) ** 3,
            distance - _SQUARED * _EQUATOR * math.cos(reduced) ** 3,
        )
        reduced = math.atan((1.0 - _FLATTENING) * math.tan(latitude))
    sin, cos = math.sin(latitude), math.cos(latitude)
    height = distance * cos + along * sin - _EQUATOR * math.sqrt(1.0 - _SQUARED * sin * sin)
    return math.degrees(latitude), math.degrees(longitude + math.atan2(east, across)), height
