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
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from typing import IO, Any

from thorvaldc.compiler.sandbox.process_limits import (
    end_with_parent,
    limit_processor_time,
    set_limits,
)
from thorvaldc.diagnostics.foreign_json import read_json

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
    more than ``max_bytes``, and ``ValueError`` if it is not a message.
    """
    line = stream.readline(max_bytes)
    if not line.endswith(b"\n"):
        if 0 <= max_bytes <= len(line):
            raise OverflowError
        raise EOFError
    fields, size = read_json(line)
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
    write_message(answers, {"missing": set_limits(start["memory_bytes"])})
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
