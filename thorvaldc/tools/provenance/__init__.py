"""Explains where a number of a robot comes from, and where it goes.

The robot is compiled and emitted with numbers that know their origins (``traced_number``).  A build
has plain numbers, so it costs nothing if nobody asks.  Begin with ``trace``.
"""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("why", "why_command:why", "Explain where a number of a robot comes from."),
)
