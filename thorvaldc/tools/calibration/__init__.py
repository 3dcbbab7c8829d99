"""Estimates wheel radii and steering offsets from a joint log; begin at ``self_calibration``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "calibrate",
        "calibrate_command:calibrate",
        "Estimate wheel radii and steering offsets from a joint log.",
    ),
)
