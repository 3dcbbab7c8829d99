"""How compiling grows with the robot: 9 and 90 drive modules."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.figure import Figure, least_times

PITCH = 1.3  # m, between wheels


def robot(rows: int, columns: int) -> str:
    """A frame with ``rows`` x ``columns`` steered drives, each with its controller.

    Nine drives take half of a bus, so there is a bus for every nine.
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

    def work(path: Path) -> object:
        done = compile_file(path)
        if done.model is None:
            raise RuntimeError(str([d.message for d in done.report.errors]))
        return emit(done.model, DEFAULT_TARGETS, done.report)

    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder, "9.yaml"), Path(folder, "90.yaml")
        small.write_text(robot(3, 3), encoding="utf-8")
        large.write_text(robot(9, 10), encoding="utf-8")
        of_small, of_large = least_times([lambda: work(small), lambda: work(large)], rounds=15)
    yield Figure(
        "growth from 9 to 90 modules",
        of_large / (10 * of_small),
        "",
        1.2,
        "lower",
        "compile and emit in process, least processor time of 15:"
        f" {of_small * 1e3:.1f} ms for 9 steered drives, {of_large * 1e3:.0f} ms for 90;"
        " over ten times the former",
    )
