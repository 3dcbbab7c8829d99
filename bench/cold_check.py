"""Time of ``thorvaldc check`` in a new process, of one robot file and of a hundred."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.figure import EXAMPLE, Figure, in_turns, process, python

FILES = 100


def figures() -> Iterator[Figure]:
    check = python("-m", "thorvaldc", "check")
    single, bare = in_turns(
        process([*check, str(EXAMPLE)]), process(python("-c", "pass")), rounds=21
    )
    yield Figure.ratio(
        "cold check over bare Python",
        22,
        zip(single, bare, strict=True),
        f"check of 4WD4WS {statistics.median(single) * 1e3:.0f} ms, `python -c pass`"
        f" {statistics.median(bare) * 1e3:.0f} ms; processor times of whole processes",
    )
    with tempfile.TemporaryDirectory() as folder:
        files = _variants(Path(folder))
        alone, together = in_turns(process([*check, files[0]]), process([*check, *files]), rounds=5)
    yield Figure.ratio(
        f"check of {FILES} robot files",
        20,
        [(FILES * one, all_files) for one, all_files in zip(alone, together, strict=True)],
        f"times faster than {FILES} processes: together {statistics.median(together):.2f} s, a"
        f" process for one file {statistics.median(alone) * 1e3:.0f} ms of processor time",
        better="higher",
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
