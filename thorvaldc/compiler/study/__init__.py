"""Reads study files: designs of one robot with variables, constraints and objectives."""
