"""Teleoperation: a person drives a robot with a keyboard or a joystick."""
