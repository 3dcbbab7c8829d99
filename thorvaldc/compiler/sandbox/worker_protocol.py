"""The worker side of the processes that read files of others, and the messages of both sides.

Protocol between the compiler (``worker_process``) and a worker process:

    compiler                                   worker
       | -- start: service, limits -----------> |  imports the service, limits itself
       | <-- missing: limits not in force ----- |
       | -- request + data -------------------> |  the limits of time count for each request
       | <-- answer + data -------------------- |
       |    ...                                 |
       | -- EOF ------------------------------> |  ends

A message is one line of JSON with the fields and the size of the data (bytes), and then the data.
A service is a module with a function ``answer(request, data)`` that returns the answer and its
data.

Worker processes import this module, so it imports only the standard library.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
from typing import IO, Any

Fields = dict[str, Any]


def write_message(stream: IO[bytes], fields: Fields, data: bytes = b"") -> None:
    """Writes a message.

    Raises ``ValueError`` if the fields cannot be written as JSON, and
    ``OSError`` if the other side has ended.
    """
    line = json.dumps([fields, len(data)], allow_nan=False).encode()
    stream.write(line + b"\n" + data)
    stream.flush()


def read_message(stream: IO[bytes], max_bytes: int = -1) -> tuple[Fields, bytes]:
    """Reads a message.

    Raises ``EOFError`` if the other side has ended, ``OverflowError`` if the line or the data has
    more than ``max_bytes``, ``ValueError`` if it is not a message, and ``RecursionError`` if its
    brackets are nested too deeply.
    """
    line = stream.readline(max_bytes)
    if not line.endswith(b"\n"):
        if 0 <= max_bytes <= len(line):
            raise OverflowError
        raise EOFError
    fields, size = json.loads(line)
    if 0 <= max_bytes < size:
        raise OverflowError
    data = stream.read(size)
    if len(data) < size:
        raise EOFError
    return fields, data


def main() -> None:
    """Answers requests until the compiler closes the pipe or ends."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # What a file or a library prints must not mix with the answers.
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
    start, _ = read_message(requests)
    end_with_parent(start["parent"])
    sys.path.extend(p for p in start["path"] if p not in sys.path)
    service = importlib.import_module(start["service"])
    for name in start["imports"]:
        importlib.import_module(name)
    missing = set_limits(start["memory_bytes"], start["file_bytes"])
    write_message(answers, {"missing": missing})
    while True:
        try:
            request, data = read_message(requests)
        except EOFError:
            return
        limit_processor_time(start["processor_seconds"])
        try:
            answer, data = service.answer(request, data)
        except MemoryError:
            answer, data = {"exceeded": "memory"}, b""
        try:
            write_message(answers, answer, data)
        except (RecursionError, ValueError):  # of the JSON encoder
            write_message(answers, {"exceeded": "depth"})
        except MemoryError:
            write_message(answers, {"exceeded": "memory"})


# -- limits of a worker process ----------------------------------------------------

# The rules of the readers decide what a file of others may reach; these limits end one that needs
# too much.

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


def set_limits(memory_bytes: int, file_bytes: int = 0) -> str:
    """Limits the memory, files and child processes of this process.

    - ``file_bytes``: size of the files that the process may write.  Devices have no size.

    Returns an empty text, or the reason why a limit is not in force.
    """
    try:
        import resource
    except ImportError:
        return "this system has no resource limits"
    missing = []
    for name, value in (
        ("RLIMIT_AS", memory_bytes),
        ("RLIMIT_FSIZE", file_bytes),
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
