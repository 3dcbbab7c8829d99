"""Compares robots, and explains where a number of a robot comes from."""
