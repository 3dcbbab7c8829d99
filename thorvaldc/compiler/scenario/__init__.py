"""Fleets and scenarios: robots placed in a world, what they do, and what is asserted.

May import: ``result`` and the rooms below.  The compiler of one robot is an argument.  Begin with
``scenario_compilation.py``.
"""
