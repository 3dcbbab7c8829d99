"""Writes a robot as an OpenUSD file; begin at ``usd_export``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("usd", "usd_command:usd", "Write a robot as an OpenUSD file (.usda, .usdc)."),
)
