"""Labels and units of the fields of the model, for a reader who knows robots and not the model."""

from __future__ import annotations

from thorvaldc.comparison.leaf_differences import ORDER, ValuePath
from thorvaldc.model import Fleet, Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.robot_facts import RobotFacts

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


def field_label(path: ValuePath) -> str:
    """Returns the label of a field with the path ``path`` in its element."""
    words = [_LABELS.get(name, name.replace("_", " ")) for name in path if name not in _SILENT]
    if words and path[-1] == ORDER:
        words[-1] = "order"
    return " ".join(words)


def field_unit(path: ValuePath) -> str:
    """Returns the SI unit of a value of the model or of a fact, or an empty text."""
    for root in (Robot, Fleet, RobotFacts):
        if path[0] in si.field_types(root):
            quantity = si.quantity_at(root, path)
            return quantity.unit if quantity else ""
    return ""
