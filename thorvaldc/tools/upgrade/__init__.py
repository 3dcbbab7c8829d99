"""Rewrites older files to the present language; begin at ``upgrade_command``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "upgrade", "upgrade_command:upgrade", "Rewrite older files to the present language."
    ),
)
