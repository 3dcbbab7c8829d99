"""Calls services of a running driver from the command line."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (CommandEntry("call", "call_command:call", "Call a service of a running driver."),)
