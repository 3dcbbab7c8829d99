"""Fleets and scenarios: placement, world, script, variations."""
