"""The commands of the core.

The module ``cli/command.py`` has their table.
"""
