"""Injects faults into a simulated robot on its buses, and measures how its driver reacts."""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry(
        "faults", "faults_command:faults", "Measure how a robot reacts to faults on its CAN bus."
    ),
)
