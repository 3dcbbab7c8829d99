"""Makes modules of CAN devices from files of others (DBC); begin at ``device_file_commands``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "modules from-dbc",
        "device_file_commands:from_dbc",
        "Make a module from the messages of a node in a DBC file.",
    ),
)
