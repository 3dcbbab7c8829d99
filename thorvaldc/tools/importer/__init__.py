"""Converts files of the original system to robot.yaml; begin at ``original_import``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "import",
        "import_command:import_original",
        "Convert a configuration of the original Thorvald system.",
    ),
)
