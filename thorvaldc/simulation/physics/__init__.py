"""Simulated bases: ideal joints, rolling without slip, and MuJoCo with faults and noise."""
