"""Reads a mesh file with the package trimesh in a contained process with limited time and memory.

A small file of these formats can describe a mesh of any size, by nested instances or compressed
parts.  The worker process has the arguments: path of the file, format.  It writes one line of JSON
to its standard output: ``{"count": number of triangles}``, followed by 9 float64 for each triangle
(three corners, little endian), or ``{"error": name of the exception class, "text": its text}``.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import sys
import warnings

from thorvaldc.compiler.containment import contain, limit_processor_time

PROCESSOR_SECONDS = 10
MEMORY_BYTES = 2 << 30
# Larger meshes are refused by the compiler.  They are not written, because they need much memory.
MAX_WRITTEN = 1_000_000


def main() -> None:
    """Reads the mesh file and writes its triangles to stdout."""
    import trimesh

    with contextlib.suppress(ImportError):
        import collada  # noqa: F401  # imported by trimesh while it reads a Collada file
    path, suffix = sys.argv[1:]
    folders = [path, os.path.dirname(path), sys.prefix, sys.base_prefix, *sys.path]
    contain([os.path.realpath(folder) for folder in folders if folder], MEMORY_BYTES)
    limit_processor_time(PROCESSOR_SECONDS)
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    data = b""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            corners = trimesh.load_scene(path, file_type=suffix).to_mesh().triangles
        answer: dict[str, object] = {"count": len(corners)}
        if len(corners) <= MAX_WRITTEN:
            data = corners.astype("<f8").tobytes()
    except Exception as error:  # The mesh readers of trimesh raise exceptions of many types.
        # The mesh file is empty or has another format than the file name suggests.
        other = isinstance(error, (AttributeError, TypeError, LookupError))
        kind = "format" if other else type(error).__name__
        answer = {"error": kind, "text": " ".join(str(error).split())[:200]}
    sys.stdout.buffer.write(json.dumps(answer).encode() + b"\n" + data)
    sys.stdout.buffer.flush()
