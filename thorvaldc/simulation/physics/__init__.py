"""Simulated bases: ideal joints, ideal rolling without slip, and MuJoCo."""
