"""A measured figure and the ways to measure it."""

from __future__ import annotations

import gc
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "examples" / "4wd4ws_wide" / "robot.yaml"


@dataclass(frozen=True)
class Figure:
    """``bound`` is ``None`` for a figure that is only told; ``how`` says how it was taken."""

    name: str
    value: float
    unit: str
    bound: float | None
    better: str  # "lower" or "higher"
    how: str

    @property
    def holds(self) -> bool:
        if self.bound is None:
            return True
        return self.value <= self.bound if self.better == "lower" else self.value >= self.bound


def python(*arguments: str) -> list[str]:
    return [sys.executable, *arguments]


def side_by_side(
    commands: Sequence[Sequence[str]], rounds: int, folder: Path = ROOT
) -> list[float]:
    """Median wall time (s) of each command as a whole process, run in turns.

    The first round fills the disk's and the bytecode's caches and does not count.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    taken: list[list[float]] = [[] for _ in commands]
    for turn in range(rounds + 1):
        for command, times in zip(commands, taken, strict=True):
            start = time.perf_counter()
            subprocess.run(
                command,
                cwd=folder,
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                check=True,
            )
            if turn > 0:
                times.append(time.perf_counter() - start)
    return [statistics.median(times) for times in taken]


def least_times(works: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Least time (s) of each call in this process, taken in turns, after one that does not count.

    Processor time, and the least of it: what else the machine does only adds.
    """
    for work in works:
        work()
    taken: list[list[float]] = [[] for _ in works]
    for _ in range(rounds):
        for work, times in zip(works, taken, strict=True):
            gc.collect()
            start = time.process_time()
            work()
            times.append(time.process_time() - start)
    return [min(times) for times in taken]


def median_time(work: Callable[[], object], rounds: int) -> float:
    """Median processor time (s) of a call in this process, after one that does not count."""
    work()
    times = []
    for _ in range(rounds):
        gc.collect()
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)
