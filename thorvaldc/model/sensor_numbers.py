"""The numbers of simulated sensors: their quantities, defaults and bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from thorvaldc.model.robot import Robot, Sensor

WORLD_ORIGIN = (59.665, 10.775, 90.0)
"""Latitude (deg), longitude (deg) and height (m) of the origin of simulated worlds for GNSS
receivers: a field in As, Norway.  The x axis of a world points east, the y axis north."""


Schema = Mapping[str, Any]
_KEYWORDS = {"above": "x-exclusive-minimum", "least": "x-minimum", "most": "x-maximum"}


def _number(quantity: str, default: float, **bounds: float | str) -> Schema:
    keywords = {_KEYWORDS[name]: bound for name, bound in bounds.items()}
    return {"x-quantity": quantity, "default": default, **keywords}


def _whole(default: int, most: int) -> Schema:
    return {**_number("number", default, least=1, most=most), "type": ["integer", "string"]}


_DEGREE = math.radians(1.0)
_LIDAR = {
    "range": _number("length", 30.0, above=0),
    "minimum_range": _number("length", 0.05, least=0),
    "range_noise": _number("length", 0.0, least=0),
    "dropouts": _number("number", 0.0, least=0, most=1),
    "rate": _number("frequency", 10.0, above=0),
    "field_of_view": _number("angle", math.tau, above=0, most="360 deg"),
    "angular_resolution": _number("angle", _DEGREE, least="0.01 deg"),
}
SENSOR_NUMBERS: Mapping[str, Mapping[str, Schema]] = {
    "lidar_2d": _LIDAR,
    "lidar_3d": {
        **_LIDAR,
        "vertical_field_of_view": _number("angle", 30.0 * _DEGREE, above=0, most="180 deg"),
        "layers": _whole(16, 1024),
    },
    "imu": {
        "rate": _number("frequency", 100.0, above=0),
        "orientation_accuracy": _number("angle", 0.0, least=0),
        "orientation_time": _number("time", 10.0, above=0),
        "gyro_noise": _number("number", 0.0, least=0),
        "gyro_bias": _number("angular_velocity", 0.0, least=0),
        "accelerometer_noise": _number("number", 0.0, least=0),
        "accelerometer_bias": _number("acceleration", 0.0, least=0),
    },
    "gnss": {
        "rate": _number("frequency", 10.0, above=0),
        "accuracy": _number("length", 0.0, least=0),
        "wander": _number("number", 0.0, least=0, most=1),
        "wander_time": _number("time", 60.0, above=0),
    },
    "camera": {
        "rate": _number("frequency", 10.0, above=0),
        "horizontal_field_of_view": _number("angle", 69.0 * _DEGREE, above=0, most="179 deg"),
        "image_width": _whole(1280, 65535),
        "image_height": _whole(720, 65535),
    },
}
"""The numbers of the sensors that simulators have, by type and name: quantity, default and bounds
in SI units, with the keywords of the schemas of documents."""


def sensor_numbers(sensor: Sensor) -> dict[str, float]:
    """Return the numbers of a simulated sensor by name, in SI units.

    A value that is missing, or is a text, has its default.
    """
    stated = {name: v for name, v in sensor.properties if not isinstance(v, str)}
    numbers = SENSOR_NUMBERS[sensor.type].items()
    return {
        name: (stated[name] if name in stated else schema["default"]) * 1.0
        for name, schema in numbers
    }


def ray_count(numbers: Mapping[str, float]) -> int:
    """Return the number of rays of one layer of a lidar, the first and the last one included."""
    return max(2, round(numbers["field_of_view"] / numbers["angular_resolution"]) + 1)


def not_simulated(robots: Iterable[Robot]) -> list[str]:
    """Return the name and the type of each sensor that simulators do not have."""
    return [
        f"`{robot.prefix}{sensor.name}` ({sensor.type})"
        for robot in robots
        for sensor in robot.sensors
        if sensor.type not in SENSOR_NUMBERS
    ]
