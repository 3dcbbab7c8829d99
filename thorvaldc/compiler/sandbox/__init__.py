"""Runs xacro and mesh readers in processes with few rights, because files of others are hostile.

May import: no other room of the compiler.  Begin with ``worker_process.py``, which starts a worker
and sends it requests; ``containment.py`` has the limits.
"""
