"""The metrics of scenarios and their units."""

UNITS = {
    "end_error": "m",
    "yaw_error": "rad",
    "path": "m",
    "length_ratio": "",
    "tilt": "rad",
    "slip": "m/s",
    "largest_slip": "m/s",
    "steering_limit_hits": "",
    "collisions": "",
    "energy": "J",
    "energy_per_metre": "J/m",
}
"""Names and units of all metrics, in the order of the output."""
