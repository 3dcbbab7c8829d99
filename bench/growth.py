"""Growth of the compile time with the size of the robot: 9 and 90 drive modules."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.figure import Figure, in_turns

PITCH = 1.3  # m, between wheels


def robot(rows: int, columns: int) -> str:
    """Returns a robot file with ``rows`` x ``columns`` steered drives, each with its controller.

    Nine drives use half of the capacity of a bus, so there is one bus for nine drives.
    """
    lines = [
        "thorvaldc: 1",
        "name: grid",
        "buses:",
        *(f"  b{k}: {{bitrate: 500 kbit/s}}" for k in range((rows * columns + 8) // 9)),
        "modules:",
        "  frame: {type: frame/tube_rectangular, params: {length: 1.1, width: 0.9}}",
    ]
    for i in range(rows * columns):
        x = (i // columns - (rows - 1) / 2) * PITCH
        y = (i % columns - (columns - 1) / 2) * PITCH
        lines.append(
            f"  d{i}: {{type: assembly/steered_drive,"
            f" mount: {{parent: frame, xyz: [{x:.3f}, {y:.3f}, 0]}},"
            f" can: {{bus: b{i // 9}, id: {i % 9 + 1}}}}}"
        )
    return "\n".join(lines) + "\n"


def figures() -> Iterator[Figure]:
    from thorvaldc.backends import DEFAULT_TARGETS
    from thorvaldc.compiler.pipeline import compile_file, emit

    def build(path: Path) -> object:
        compilation = compile_file(path)
        if compilation.model is None:
            raise RuntimeError(str([d.message for d in compilation.report.errors]))
        return emit(compilation.model, DEFAULT_TARGETS, compilation.report)

    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder, "9.yaml"), Path(folder, "90.yaml")
        small.write_text(robot(3, 3), encoding="utf-8")
        large.write_text(robot(9, 10), encoding="utf-8")
        tens, larges = in_turns(
            lambda: [build(small) for _ in range(10)], lambda: build(large), rounds=5
        )
    yield Figure.ratio(
        "growth from 9 to 90 modules",
        1.2,
        zip(larges, tens, strict=True),
        "compile and emit in process, processor time for 90 steered drives"
        f" ({statistics.median(larges) * 1e3:.0f} ms) over that of ten times 9",
    )
