"""Builds robots and simulates each robot from the generated files; begin at ``demo``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "demo",
        "demo:demo",
        "Build robots, drive each in simulation, print a table.",
        hidden=True,
    ),
)
