"""Runs many variations of a scenario; begin at ``scenario_batch``."""
