"""Runs many variations of a scenario; begin at ``scenario_batch``."""

from thorvaldc.tool_folders import SIMULATION, CommandEntry

COMMANDS = (
    CommandEntry(
        "batch",
        "batch_command:batch",
        "Run variations of a scenario in parallel.",
        topic=SIMULATION,
    ),
)
