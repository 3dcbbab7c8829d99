"""Names and units of the fields of the model, for a reader who knows robots and not the model."""

from __future__ import annotations

from thorvaldc.tools.comparison.leaf_differences import ORDER, ValuePath

_LABELS = {
    "com": "centre of mass",
    "max_velocity": "speed limit",
    "max_acceleration": "acceleration limit",
    "max_torque": "torque limit",
    "max_linear_velocity": "speed limit",
    "max_angular_velocity": "turning limit",
    "max_linear_acceleration": "acceleration limit",
    "max_angular_acceleration": "turning acceleration limit",
    "max_linear_deceleration": "deceleration of a stop",
    "max_angular_deceleration": "turning deceleration of a stop",
    "encoder_ppr": "encoder pulses",
    "x": "x position",
    "y": "y position",
    "xyz": "position",
    "quat": "orientation (quaternion)",
    "motor_max_speed": "motor speed limit",
}
"""Labels that differ from the name of the field with spaces."""

_SILENT = ("inertial", "properties", "options", "driver")
"""Fields whose names say nothing to a reader."""

_UNITS: dict[str, dict[str, str]] = {
    "inertial": {"mass": "kg", "com": "m"},
    "links": {"mass": "kg", "com": "m"},
    "joints": {
        **dict.fromkeys(("lower", "upper"), "rad or m"),
        "effort": "N m or N",
        "velocity": "rad/s or m/s",
    },
    "wheels": {
        **dict.fromkeys(("x", "y", "trail", "lateral_offset", "radius", "width", "radii"), "m"),
        "contact_height": "m",
        "heading": "rad",
        "load": "N",
    },
    "actuators": {
        "motor_max_speed": "rad/s",
        "max_velocity": "rad/s",
        "max_acceleration": "rad/s^2",
        "max_torque": "N m",
        "armature": "kg m^2",
        "encoder_offset": "rad",
    },
    "driver": {
        "rate": "Hz",
        "command_timeout": "s",
        "max_linear_velocity": "m/s",
        "max_angular_velocity": "rad/s",
        "max_linear_acceleration": "m/s^2",
        "max_angular_acceleration": "rad/s^2",
        "max_linear_deceleration": "m/s^2",
        "max_angular_deceleration": "rad/s^2",
        "arming_timeout": "s",
        "stopping_distance": "m",
        "silence": "s",
    },
    "twist_sources": {"timeout": "s"},
    "twist_locks": {"timeout": "s"},
    "buses": {
        "bitrate": "bit/s",
        "sync_period": "s",
        "load": "share",
        "period": "s",
        "deadline": "s",
        "minimum_interval": "s",
        "heartbeat_timeout": "s",
        "heartbeat_consumer_time": "s",
        "command_watchdog": "s",
    },
    "placements": {"xyz": "m"},
    # Parts of the facts.
    "size": dict.fromkeys(
        ("length", "width", "height", "lower", "upper", "wheelbase", "track", "ground_clearance"),
        "m",
    ),
    "stability": {
        "margin": "m",
        **dict.fromkeys(("angles", "least", "polar"), "rad"),
    },
    "driving": {
        **dict.fromkeys(("forwards", "sideways"), "m/s"),
        "acceleration": "m/s^2",
        **dict.fromkeys(("x", "y", "radius", "wheel_circle", "outer_circle"), "m"),
        "yaw_rate": "rad/s",
    },
    "slopes": dict.fromkeys(("grip", "torque", "tip_over", "steepest", "stops"), "rad"),
    "standing": dict.fromkeys(("motors_off", "braked"), "rad"),
    "energy": {
        "voltage": "V",
        "capacity": "A s",
        "energy": "J",
        "rolling_force": "N",
        "range_bound": "m",
        "power": "W",
        "standby": "s",
    },
}
"""SI units of fields, by the first and the last name of the path of a value or fact."""


def field_label(path: ValuePath) -> str:
    """Returns the label of a field with the path ``path`` in its element."""
    words = [_LABELS.get(name, name.replace("_", " ")) for name in path if name not in _SILENT]
    if words and path[-1] == ORDER:
        words[-1] = "order"
    return " ".join(words)


def field_unit(path: ValuePath) -> str:
    """Returns the SI unit of a value of the model, or an empty text."""
    units = _UNITS.get("driver" if "driver" in path[:-1] else path[0], {})
    for name in reversed(path):
        if name in units:
            return units[name]
    return ""
