"""The library of module types, and the tree of modules that a robot document makes of them.

May import: ``values``, ``validation``, ``source``.  Begin with ``resolve.py``: it takes module
types from ``library.py``, evaluates their parameters (``module_parameters.py``), mounts them on
each other (``mounting.py``) and returns the tree (``module_tree.py``, with references to ports).
"""
