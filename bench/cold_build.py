"""Time of a build as a whole process, relative to a process that only imports usual packages."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

from bench.figure import EXAMPLE, Figure, python, side_by_side

BARE = "import typer, yaml, jsonschema, numpy"


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        build = python("-m", "thorvaldc", "build", str(EXAMPLE), "-o", f"{folder}/out")
        ours, bare = side_by_side([build, python("-c", BARE)], rounds=21)
    yield Figure(
        "cold build over bare imports",
        ours / bare,
        "",
        1.25,
        "lower",
        f"build of 4WD4WS to all four targets {ours * 1e3:.0f} ms,"
        f" `{BARE}` {bare * 1e3:.0f} ms; whole processes in turns, medians of 21",
    )
