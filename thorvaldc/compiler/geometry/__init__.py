"""Computes wheel geometry and static wheel loads, reads meshes, and checks complete robots."""
