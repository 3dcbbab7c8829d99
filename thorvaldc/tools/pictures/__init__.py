"""Draws and shows robots; begin at ``picture_commands``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("render", "picture_commands:render", "Draw a picture of a robot or fleet."),
    CommandEntry(
        "view", "picture_commands:view", "Show a robot in MuJoCo's viewer or as a web page."
    ),
)
