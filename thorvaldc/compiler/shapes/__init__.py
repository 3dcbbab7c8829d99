"""Solids and meshes: volume, centre of mass, inertia, and the formats STL, OBJ, DAE.

May import: ``sandbox``, ``source``.  Begin with ``solids.py`` and ``meshes.py``.
"""
