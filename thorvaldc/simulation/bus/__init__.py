"""A simulated CAN bus with a robot's devices on it, in virtual time or by the clock.

See docs/simulated-bus.md.  Nothing here imports python-can but ``interface``, which is
python-can's way in.
"""
