"""Finds contradictions in the files of any robot.

Readers, one for each format, turn files to descriptions of the robot, sections of parameters and
launched nodes, whose values have source spans (``audit_facts``).  ``audit_run`` has the table of
rules: a rule is a function that compares them and reports contradictions.
"""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "audit", "audit_command:audit", "Report contradictions in the files of any robot."
    ),
)
