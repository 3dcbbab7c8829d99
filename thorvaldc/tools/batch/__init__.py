"""Runs many variations of a scenario; begin at ``scenario_batch``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("batch", "batch_command:batch", "Run variations of a scenario in parallel."),
)
