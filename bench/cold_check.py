"""Time of ``thorvaldc check`` in a new process, of one robot file and of a hundred."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.figure import EXAMPLE, Figure, python, side_by_side

FILES = 100


def figures() -> Iterator[Figure]:
    check = python("-m", "thorvaldc", "check")
    single, bare = side_by_side([[*check, str(EXAMPLE)], python("-c", "pass")], rounds=21)
    yield Figure(
        "cold check over bare Python",
        single / bare,
        "",
        15,
        "lower",
        f"check of 4WD4WS {single * 1e3:.0f} ms, `python -c pass` {bare * 1e3:.0f} ms;"
        " whole processes in turns, medians of 21",
    )
    with tempfile.TemporaryDirectory() as folder:
        files = _variants(Path(folder))
        together, alone = side_by_side([[*check, *files], [*check, files[0]]], rounds=5)
    yield Figure(
        f"check of {FILES} robot files",
        FILES * alone / together,
        "",
        20,
        "higher",
        f"times faster than {FILES} processes, one after the other: together {together:.2f} s, a"
        f" process for one file {alone * 1e3:.0f} ms; in turns, medians of 5",
    )


def _variants(folder: Path) -> list[str]:
    """Writes copies of the example with other widths, and returns their paths."""
    text = EXAMPLE.read_text(encoding="utf-8")
    files = []
    for number in range(FILES):
        path = folder / str(number) / "robot.yaml"
        path.parent.mkdir()
        width = f"width: 1.{600 + number} m"
        path.write_text(text.replace("width: 1.60 m", width), encoding="utf-8")
        files.append(str(path))
    return files
