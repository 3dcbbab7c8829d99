"""The kinds of quantities of the facts about a robot, by the path of the fact."""

from __future__ import annotations

from fnmatch import fnmatchcase

NUMBER, MONEY = "number", "money"
PATTERNS: dict[str, tuple[str, ...]] = {
    "length": (
        "size.*",
        "center_of_mass.*",
        "wheels.*.[xy]",
        "wheels.*.radius",
        "stability.margin",
        "driving.turn.[xy]",
        "driving.turn.radius",
        "driving.turn.*_circle",
        "energy.range_bound",
    ),
    "mass": ("mass", "*.mass", "bill.*.total"),
    MONEY: ("purchase.price", "purchase.items.*.price", "purchase.items.*.total"),
    "angle": (
        "stability.angles.*",
        "stability.least.*",
        "stability.polar.*",
        "slopes.*wards.*",
        "standing.*",
    ),
    "velocity": ("driving.forwards", "driving.sideways"),
    "acceleration": ("driving.acceleration",),
    "angular_velocity": ("driving.turn.yaw_rate",),
    "force": ("wheels.*.load", "wheels.*.load_range.*", "soil.wheel_load", "energy.rolling_force"),
    "torque": ("wiring.*.max_torque",),
    "energy": ("energy.energy", "energy.batteries.*.energy"),
    "power": ("energy.power",),
    "voltage": ("energy.voltage", "energy.batteries.*.voltage"),
    "charge": ("energy.capacity", "energy.batteries.*.capacity"),
    "current": ("energy.standby_current",),
    "time": (
        "energy.standby",
        "buses.*.period",
        "purchase.lead_time",
        "purchase.items.*.lead_time",
    ),
    "pressure": ("soil.pressure",),
    "bitrate": ("buses.*.bitrate",),
    NUMBER: (
        "*.count",
        "*.id",
        "*.share",
        "buses.*.frames",
        "buses.*.load",
        "buses.*.master_id",
        "slopes.friction.*",
        "slopes.rolling_resistance.*",
        "wiring.*.encoder_ppr",
        "wiring.*.gear_ratio",
    ),
}
"""Kinds of quantities, and the patterns of the paths of their facts. ``*`` stands for any text."""


def fact_quantity(path: str) -> str:
    """Return the kind of quantity of a fact, such as ``length`` for ``size.width``.

    ``path`` : keys of the fact in the JSON values of ``facts_document``, joined by dots.
    """
    for quantity, patterns in PATTERNS.items():
        if any(fnmatchcase(path, pattern) for pattern in patterns):
            return quantity
    return NUMBER
