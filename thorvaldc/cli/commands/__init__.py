"""The commands of thorvaldc, with one module for each command.

The module ``cli/app.py`` contains the list of all commands.
"""
