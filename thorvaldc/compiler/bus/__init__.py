"""CAN buses of a robot: node ids, frames, signals, the lock file, and their checks.

May import: ``robot_settings`` and the rooms below.  Begin with ``assemble_buses.py``
(which motor is on which channel, and the nodes and frames of each bus).
"""
