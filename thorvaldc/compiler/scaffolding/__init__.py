"""Files of a new robot, project or module (``thorvaldc new``, ``thorvaldc modules new``).

May import: ``modules``, ``shapes`` and the rooms below.  Begin with ``new_project.py``.
"""
