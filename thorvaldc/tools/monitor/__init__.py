"""Shows frames, load and nodes of a CAN bus, and sends nothing; begin at ``bus_monitor``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "can monitor",
        "monitor_command:monitor",
        "Show frames, bus load and node states; sends nothing.",
    ),
)
