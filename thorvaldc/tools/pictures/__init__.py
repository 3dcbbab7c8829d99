"""Draws and shows robots, and recorded runs again; begin at ``picture_commands``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("render", "picture_commands:render", "Draw a picture of a robot or fleet."),
    CommandEntry(
        "replay", "picture_commands:replay", "Show a recorded run again, without physics."
    ),
    CommandEntry(
        "view", "picture_commands:view", "Show a robot in MuJoCo's viewer or as a web page."
    ),
)
