"""Explains where a number of a robot comes from, and where it goes.

Nothing in the compiler records where numbers come from.  Instead, the robot is compiled again with
values of its documents changed a little: a value whose change reaches the number is a source of the
number.  The method is exact for any expression, and costs nothing if nobody asks.
"""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("why", "why_command:why", "Explain where a number of a robot comes from."),
)
