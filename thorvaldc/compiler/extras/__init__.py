"""The section ``extras``: additional xacro and URDF files of others, joined to the robot.

``sdf_reader`` makes URDF elements of SDF files for tools.

May import: ``hardware`` and the rooms below, but not ``bus``.  Begin with ``load_extras.py``.
"""
