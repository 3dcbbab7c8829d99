"""Time of a build in a new process, relative to a process that only imports common packages."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Iterator

from bench.figure import EXAMPLE, Figure, in_turns, process, python

BARE = "import typer, yaml, jsonschema, numpy"


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        build = python("-m", "thorvaldc", "build", str(EXAMPLE), "-o", f"{folder}/out")
        builds, bare = in_turns(process(build), process(python("-c", BARE)), rounds=21)
    yield Figure.ratio(
        "cold build over bare imports",
        1.8,
        zip(builds, bare, strict=True),
        f"build of 4WD4WS to all four targets {statistics.median(builds) * 1e3:.0f} ms,"
        f" `{BARE}` {statistics.median(bare) * 1e3:.0f} ms; processor times of whole processes",
    )
