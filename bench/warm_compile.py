"""Compile time after the first compilation in a process, and the time of xacro for comparison."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path

from bench.figure import EXAMPLE, Figure, in_turns

FOUR_WHEELS = Path(__file__).parent / "four_wheels.xacro"


def figures() -> Iterator[Figure]:
    import xacro

    from thorvaldc.backends import DEFAULT_TARGETS
    from thorvaldc.compiler.pipeline import compile_file, emit

    def compile_example() -> object:
        compilation = compile_file(EXAMPLE)
        if compilation.model is None:
            raise RuntimeError("the example does not compile")
        return emit(compilation.model, DEFAULT_TARGETS, compilation.report)

    def expand_xacro() -> object:
        return xacro.process_file(str(FOUR_WHEELS)).toxml()

    warm, expansion = map(statistics.median, in_turns(compile_example, expand_xacro, rounds=21))
    yield Figure(
        "warm compile and emit",
        warm * 1e3,
        "ms",
        None,
        "lower",
        "4WD4WS from robot.yaml to the files of all four targets in memory, in process,"
        " median processor time of 21; xacro expands a four-wheel robot to URDF alone in"
        f" {expansion * 1e3:.1f} ms",
    )
