"""Converts files of others to robot.yaml; begin at ``original_import`` and ``urdf_import``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "import",
        "import_command:import_file",
        "Convert a URDF, or a file of the original Thorvald system.",
    ),
)
