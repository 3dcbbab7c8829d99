"""Reads fleets and scenarios: robot placement, world, script of commands and variations."""
