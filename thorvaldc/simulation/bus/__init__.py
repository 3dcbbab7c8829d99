"""A simulated CAN bus with a robot's devices, in virtual time or in real time.

See docs/simulated-bus.md.  Only ``python_can_plugin`` imports python-can.
"""
