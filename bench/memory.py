"""Peak memory of a build."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator

from bench.figure import EXAMPLE, ROOT, Figure, python

# A separate small process measures its children: its own memory does not count.
MEASURE = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        build = python("-m", "thorvaldc", "build", str(EXAMPLE), "-o", f"{folder}/out")
        process = subprocess.run(
            python("-c", MEASURE, *build), cwd=ROOT, check=True, capture_output=True, text=True
        )
    yield Figure(
        "peak memory of a build",
        int(process.stdout) / 1024,
        "MB",
        150,
        "lower",
        "largest resident set of the process that builds 4WD4WS to all four targets",
    )
