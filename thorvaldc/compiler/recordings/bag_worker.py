"""Reads a ROS bag in a process with limits of time and memory.

A bag of some kilobytes can expand to gigabytes, or state that it does, by its compressed chunks or
its index.  The compiler reads a bag only after this process has read it.

The process prints one line of JSON: ``{}``, or ``{"error": ...}`` with the reason.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path


def main() -> None:
    """Reads the bag ``sys.argv[1]``.

    The other arguments are limits: the address space (bytes), the processor time (s), and the size
    of a file to which the bag is unpacked (bytes).
    """
    memory_bytes, processor_seconds, file_bytes = map(int, sys.argv[2:])
    try:
        import resource
    except ImportError:  # only Unix has this module
        pass
    else:
        for kind, limit in (
            (resource.RLIMIT_AS, memory_bytes),
            (resource.RLIMIT_CPU, processor_seconds),
            (resource.RLIMIT_FSIZE, file_bytes),
        ):
            _, hard = resource.getrlimit(kind)
            resource.setrlimit(kind, (limit if hard < 0 else min(limit, hard), hard))
    print(json.dumps(_read(Path(sys.argv[1]))))


def _read(path: Path) -> dict[str, str]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    no_memory = {"error": "it needs too much memory to read"}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            for _ in reader.messages():
                pass
    except MemoryError:
        return no_memory
    except Exception as error:  # rosbags raises many types of exceptions for a damaged bag
        # lz4 raises RuntimeError if it has no memory.
        if isinstance(error.__context__, MemoryError) or "resize buffer" in str(error):
            return no_memory
        return {"error": " ".join(str(error).split())[:300] or type(error).__name__}
    return {}
