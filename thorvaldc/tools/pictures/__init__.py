"""Draws and shows robots, and recorded runs again; begin at ``render_command``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("render", "render_command:render", "Draw a picture of a robot or fleet."),
    CommandEntry("replay", "replay_command:replay", "Show a recorded run again, without physics."),
    CommandEntry("view", "view_command:view", "Show a robot in MuJoCo's viewer or as a web page."),
)
