"""The numbers of a sensor, with the defaults for a module that does not state them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from thorvaldc.model.robot import Sensor

WORLD_ORIGIN = (59.665, 10.775, 90.0)
"""Latitude (deg), longitude (deg) and height (m) of the origin of simulated worlds for GNSS
receivers: a field in As, Norway.  The x axis of a world points east, the y axis north."""

_LIDAR = {"range": 30.0, "minimum_range": 0.05, "range_noise": 0.0, "dropouts": 0.0, "rate": 10.0}
_LIDAR |= {"field_of_view": math.tau, "angular_resolution": math.radians(1.0)}
_IMU = ("gyro_noise", "gyro_bias", "accelerometer_noise", "accelerometer_bias")
_IMAGE = {"image_width": 1280.0, "image_height": 720.0}
_DEFAULTS: Mapping[str, Mapping[str, float]] = {
    "lidar_2d": _LIDAR,
    "lidar_3d": {**_LIDAR, "vertical_field_of_view": math.radians(30.0), "layers": 16.0},
    "imu": {
        "rate": 100.0,
        "orientation_accuracy": 0.0,
        "orientation_time": 10.0,
        **dict.fromkeys(_IMU, 0.0),
    },
    "gnss": {"rate": 10.0, "accuracy": 0.0, "wander": 0.0, "wander_time": 60.0},
    "camera": {"rate": 10.0, "horizontal_field_of_view": math.radians(69.0), **_IMAGE},
}
SIMULATED = tuple(_DEFAULTS)
"""Types of the sensors that simulators have."""


def sensor_numbers(sensor: Sensor) -> dict[str, float]:
    """Return the numbers of a simulated sensor by name, in SI units.

    A value that is missing, or is a text, has its default.
    """
    stated = {name: v for name, v in sensor.properties if not isinstance(v, str)}
    return {name: float(stated.get(name, v)) for name, v in _DEFAULTS[sensor.type].items()}


def ray_count(numbers: Mapping[str, float]) -> int:
    """Return the number of rays of one layer of a lidar, the first and the last one included."""
    return max(2, round(numbers["field_of_view"] / numbers["angular_resolution"]) + 1)


def wrong_numbers(sensor: Sensor) -> list[str]:
    """Return the names of the numbers of a sensor that no sensor can have: negative ones, zero
    where the default is a positive number, and a share above 1."""
    if sensor.type not in SIMULATED:
        return []
    defaults = {**_DEFAULTS[sensor.type], "minimum_range": 0.0}
    shares = ("dropouts", "wander")
    return [
        name
        for name, value in sensor_numbers(sensor).items()
        if value < 0.0 or (value == 0.0 < defaults[name]) or (name in shares and value > 1.0)
    ]
