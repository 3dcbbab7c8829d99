"""Differences of two robots: values, modules and facts; begin at ``robot_comparison``."""
