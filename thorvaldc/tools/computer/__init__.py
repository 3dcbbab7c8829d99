"""Installs a robot on its computer, and removes it; begin at ``installed_versions``."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "install", "install_commands:install", "Install a robot on its computer: services, names."
    ),
    CommandEntry(
        "uninstall", "install_commands:uninstall", "Remove an installed robot from its computer."
    ),
    CommandEntry(
        "status", "status_commands:status", "Show what the installed robots of a computer do."
    ),
    CommandEntry(
        "logs", "status_commands:logs", "Show what the services of installed robots have written."
    ),
)
