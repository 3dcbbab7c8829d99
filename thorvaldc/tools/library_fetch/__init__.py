"""Fetches libraries of modules from repositories and archives; begin at ``library_fetch``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "modules fetch",
        "fetch_command:fetch",
        "Fetch the libraries of robots from repositories and archives.",
    ),
)
