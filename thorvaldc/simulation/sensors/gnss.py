"""GNSS receivers."""

from __future__ import annotations

import math

from thorvaldc.model.sensor_numbers import WORLD_ORIGIN
from thorvaldc.simulation.sensors.simulated_sensor import Array, Message, SimulatedSensor, diagonal

_EQUATOR, _SQUARED = 6378137.0, 0.0066943799901413165
"""Semi-major axis (m) and square of the first eccentricity of the ellipsoid WGS 84."""


class Gnss(SimulatedSensor):
    """A GNSS receiver with its antenna at the measurement frame.

    The share ``wander`` of the variance of a fix changes slowly, and the rest is white.  The stated
    variance is that of a fix, as receivers state it.
    """

    def measure(self) -> list[Message]:
        accuracy, share = self.numbers["accuracy"], self.numbers["wander"]
        slow = self._slow_errors(accuracy * math.sqrt(share), self.numbers["wander_time"])
        white = self._errors(accuracy * math.sqrt(1.0 - share), 3)
        place = geodetic(self.seen.level @ self.pose()[0] + slow + white)
        latitude, longitude, altitude = place
        # A fix with corrections of a base station, by the system GPS.
        fix = self._message(
            "NavSatFix",
            status=Message("sensor_msgs/msg/NavSatStatus", status=2, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=diagonal(accuracy**2),
            position_covariance_type=2 if accuracy else 0,  # the diagonal is known, or nothing
        )
        return [fix]


def geodetic(position: Array) -> tuple[float, float, float]:
    """Returns latitude (deg), longitude (deg) and height (m) of a position (3) east, north and up
    of ``WORLD_ORIGIN`` in m, which is a vector in the tangent plane, as in Gazebo.

    The latitude is the fixed point of tan(latitude) = (z + e^2 N sin(latitude)) / p, with the
    distance p from the axis; each round multiplies the error by e^2.
    """
    latitude, longitude = (math.radians(angle) for angle in WORLD_ORIGIN[:2])
    east, north, up = position.tolist()
    sin, cos = math.sin(latitude), math.cos(latitude)
    normal = _EQUATOR / math.sqrt(1.0 - _SQUARED * sin * sin)
    # In the meridian plane of the origin: distance from the axis, and along the axis.
    across = (normal + WORLD_ORIGIN[2]) * cos - sin * north + cos * up
    along = (normal * (1.0 - _SQUARED) + WORLD_ORIGIN[2]) * sin + cos * north + sin * up
    distance = math.hypot(across, east)
    for _ in range(7):
        latitude = math.atan2(along + _SQUARED * normal * sin, distance)
        sin, cos = math.sin(latitude), math.cos(latitude)
        normal = _EQUATOR / math.sqrt(1.0 - _SQUARED * sin * sin)
    height = distance * cos + along * sin - _EQUATOR**2 / normal
    return math.degrees(latitude), math.degrees(longitude + math.atan2(east, across)), height
