"""Standard gravity in m/s^2, used by all backends and checks."""

GRAVITY = 9.81
"""Acceleration of free fall in m/s^2, equal to the default value of MuJoCo."""
