"""Converts files of the original system to robot.yaml; begin at ``original_import``."""
