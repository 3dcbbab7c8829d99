"""Limits a worker process: memory, processor time, files and child processes.

The rules of the readers decide what a file of others may reach; these limits end one that needs too
much.  The module imports only the standard library, because worker processes import it.
"""

from __future__ import annotations

import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def end_with_parent(parent: int) -> None:
    """Ends this process with SIGKILL when its parent process ends, whatever ends the parent.

    Only Linux has this.  On other systems, the process ends when it reads the end of its input, or
    at its limit of processor time.

    - ``parent``: id of the parent process, which may have ended before this call.
    """
    if sys.platform == "linux":
        import ctypes

        libc = ctypes.CDLL(None, use_errno=True)
        libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


def set_limits(memory_bytes: int) -> str:
    """Limits the memory, files and child processes of this process.

    Returns an empty text, or the reason why a limit is not in force.
    """
    try:
        import resource
    except ImportError:
        return "this system has no resource limits"
    missing = []
    for name, value in (
        ("RLIMIT_AS", memory_bytes),
        ("RLIMIT_FSIZE", 0),  # the process cannot write to files
        ("RLIMIT_CORE", 0),
        ("RLIMIT_NOFILE", 128),
        ("RLIMIT_NPROC", 0),
    ):
        try:
            resource.setrlimit(getattr(resource, name), (value, value))
        except (AttributeError, ValueError, OSError):
            missing.append(name)
    return f"not supported: {', '.join(missing)}" if missing else ""


def limit_processor_time(seconds: int) -> None:
    """Ends this process with the signal SIGXCPU after more processor time (s) from now on."""
    try:
        import resource

        hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
        limit = int(os.times().user + os.times().system) + seconds
        resource.setrlimit(resource.RLIMIT_CPU, (limit, hard))
    except (ImportError, ValueError, OSError):
        return
