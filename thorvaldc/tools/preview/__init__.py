"""Serves a page that shows a robot while its file is edited."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "preview", "preview_command:preview", "Show a robot in a browser while you edit it."
    ),
)
