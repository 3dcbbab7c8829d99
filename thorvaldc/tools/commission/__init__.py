"""Checks the first motion of a newly assembled robot; begin at ``commission_command``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "can commission",
        "commission_command:commission",
        "Check the first motion of each motor, wheels off the ground.",
    ),
)
