"""A measured figure, and functions that measure times."""

from __future__ import annotations

import gc
import importlib.util
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
    """A measured value with its bound; ``how`` describes the measurement.

    A figure without a bound is information: it is printed but not judged.  A figure is ``timed`` if
    it depends on the speed of the machine, and thus on other programs that run.
    """

    name: str
    value: float
    unit: str
    bound: float | None
    better: str  # "lower" or "higher"
    how: str
    timed: bool = False

    def verdict(self, is_busy: bool) -> str:
        """Returns ``info``, ``holds`` or ``FAILS``, or ``busy`` where a time cannot be judged."""
        if self.bound is None:
            return "info"
        if self.timed and is_busy:
            return "busy"
        holds = self.value <= self.bound if self.better == "lower" else self.value >= self.bound
        return "holds" if holds else "FAILS"


def python(*arguments: str) -> list[str]:
    """Returns a command that runs this Python interpreter."""
    return [sys.executable, *arguments]


def side_by_side(
    commands: Sequence[Sequence[str]], rounds: int, folder: Path = ROOT
) -> list[float]:
    """Returns the median wall time (s) of each command, including the start of its process.

    The commands run in turns: a change of the machine's speed then affects all of them.  The
    first round fills the caches of disk and bytecode and does not count.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    all_times: list[list[float]] = [[] for _ in commands]
    for turn in range(rounds + 1):
        for command, times in zip(commands, all_times, strict=True):
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
    return [statistics.median(times) for times in all_times]


def least_times(functions: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Returns the least processor time (s) of each function, called in turns in this process.

    Other work of the machine can only make a call slower, so the least time has the least
    disturbance.  The first call of each function does not count.
    """
    for function in functions:
        function()
    all_times: list[list[float]] = [[] for _ in functions]
    for _ in range(rounds):
        for function, times in zip(functions, all_times, strict=True):
            gc.collect()
            start = time.process_time()
            function()
            times.append(time.process_time() - start)
    return [min(times) for times in all_times]


def median_time(function: Callable[[], object], rounds: int) -> float:
    """Returns the median processor time (s) of a call; the first call does not count."""
    function()
    times = []
    for _ in range(rounds):
        gc.collect()
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return statistics.median(times)


def is_compiled() -> bool:
    """Returns whether the control cycle is machine code; run the bench in build/compiled then."""
    driver = importlib.util.find_spec("thorvaldc.runtime.driver")
    return driver is not None and not str(driver.origin).endswith(".py")
