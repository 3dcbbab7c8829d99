"""Standard gravity as all outputs and checks use it."""

GRAVITY = 9.81
"""Acceleration of free fall in m/s^2; MuJoCo's default value."""
