"""The section ``extras``: additional xacro and URDF files of others, joined to the robot.

May import: ``hardware`` and the rooms below, but not ``bus``.  Begin with ``load_extras.py``.
"""
