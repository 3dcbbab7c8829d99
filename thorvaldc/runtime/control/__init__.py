"""The control channel of a running driver: other programs publish twists and call services.

It carries lines of JSON over a local socket; see docs/teleoperation.md.
"""
