"""Builds robots and simulates each robot from the generated files; begin at ``demo``."""
