"""The control channel of a running driver: other programs publish twists and call services.

JSON lines over a local socket, see docs/teleoperation.md.
"""
