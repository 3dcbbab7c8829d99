"""Writes the files of a build, all or none, and says whether a build is up to date.

May import: ``result`` and the rooms below.  Begin with ``writer.py``.
"""
