"""Wheel geometry, static loads, meshes, and checks of a robot's statics and mobility."""
