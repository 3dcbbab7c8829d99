"""The commands of the core; ``cli/main.py`` has their table."""
