"""Compares robots, builds and git revisions; begin at ``compared_inputs``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "diff", "comparison_commands:diff", "Compare two robots, builds or git revisions."
    ),
    CommandEntry(
        "info", "comparison_commands:info", "Show size, loads, limits, wiring and parts of a robot."
    ),
)
