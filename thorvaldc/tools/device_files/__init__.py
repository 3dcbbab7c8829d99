"""Makes modules of CAN devices from DBC and EDS files; begin at ``device_file_commands``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "modules from-dbc",
        "device_file_commands:from_dbc",
        "Make a module from the messages of a node in a DBC file.",
    ),
    CommandEntry(
        "modules from-eds",
        "device_file_commands:from_eds",
        "Make a module from the EDS or DCF file of a CANopen device.",
    ),
)
