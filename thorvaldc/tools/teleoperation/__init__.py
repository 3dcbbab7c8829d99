"""A person drives a robot with a keyboard or a joystick; begin at ``keyboard``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "teleop", "teleop_command:teleop", "Drive a robot with the keyboard or a joystick."
    ),
)
