"""Simulated CAN buses with the devices of a robot, in virtual time or in real time.

The page docs/simulated-bus.md describes the simulated bus.  Only the module ``python_can_plugin``
imports python-can.
"""
