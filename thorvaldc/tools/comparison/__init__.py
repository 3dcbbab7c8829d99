"""Compares robots, builds and git revisions; begin at ``compared_inputs``."""
