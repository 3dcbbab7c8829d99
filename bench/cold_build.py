"""Time of a build in a new process, relative to a process that only imports common packages."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

from bench.figure import EXAMPLE, Figure, python, side_by_side

BARE = "import typer, yaml, jsonschema, numpy"


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        build = python("-m", "thorvaldc", "build", str(EXAMPLE), "-o", f"{folder}/out")
        build_time, bare = side_by_side([build, python("-c", BARE)], rounds=21)
    yield Figure(
        "cold build over bare imports",
        build_time / bare,
        "",
        1.25,
        "lower",
        f"build of 4WD4WS to all four targets {build_time * 1e3:.0f} ms,"
        f" `{BARE}` {bare * 1e3:.0f} ms; whole processes in turns, medians of 21",
        timed=True,
    )
