"""Runs xacro and mesh readers in limited processes, because files of others are hostile.

May import: no other room of the compiler.  Begin with ``worker_process.py``, which starts a worker
and sends it requests; ``worker_protocol.py`` runs in the worker and limits it.
"""

missing_limits: list[str] = []
"""Limits that were not in force in the worker processes so far."""
