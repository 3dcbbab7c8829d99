"""A measured figure, and functions that measure processor times."""

from __future__ import annotations

import functools
import gc
import importlib.util
import math
import os
import resource
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "examples" / "4wd4ws_wide" / "robot.yaml"


@dataclass(frozen=True)
class Figure:
    """A measured value with its bound; ``how`` describes the measurement.

    A figure without a bound is information: it is printed but not judged.  ``spread`` contains the
    median of many more measurements in 19 of 20 cases.  A figure that is ``timed`` has nothing
    beside it that other programs disturb as much: a miss on a busy machine is none.
    """

    name: str
    value: float
    unit: str
    bound: float | None
    better: str  # "lower" or "higher"
    how: str
    timed: bool = False
    spread: tuple[float, float] | None = None

    @classmethod
    def ratio(
        cls,
        name: str,
        bound: float | None,
        pairs: Iterable[tuple[float, float]],
        how: str,
        better: str = "lower",
        unit: str = "",
    ) -> Figure:
        """Returns the median of the ratios of pairs, each measured one directly after the other.

        Other programs disturb both times of a pair, and thus hardly their ratio.
        """
        ratios = sorted(one / other for one, other in pairs)
        count = len(ratios)
        rank = int(max(count / 2 - math.sqrt(count), 0.0))  # two deviations of the binomial
        spread = (ratios[rank], ratios[-1 - rank])
        how = f"{spread[0]:.3g} to {spread[1]:.3g} by {count} pairs; {how}"
        return cls(name, statistics.median(ratios), unit, bound, better, how, spread=spread)

    def verdict(self, is_busy: bool) -> str:
        """Returns ``info``, ``holds``, ``FAILS``, or ``unclear`` where it cannot be judged."""
        if self.bound is None:
            return "info"
        ends = {
            value <= self.bound if self.better == "lower" else value >= self.bound
            for value in self.spread or (self.value,)
        }
        if ends == {True}:
            return "holds"
        return "unclear" if True in ends or (self.timed and is_busy) else "FAILS"


def python(*arguments: str) -> list[str]:
    """Returns a command that runs this Python interpreter."""
    return [sys.executable, *arguments]


def process(command: Sequence[str], folder: Path = ROOT) -> Callable[[], object]:
    """Returns a function that runs a command in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    run = functools.partial(subprocess.run, command, cwd=folder, env=environment, check=True)
    return functools.partial(run, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def processor_time() -> float:
    """Returns the processor time (s) of this process and of its ended children."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return math.fsum(usage.ru_utime + usage.ru_stime for usage in usages)


def in_turns(*functions: Callable[[], object], rounds: int) -> list[list[float]]:
    """Returns the processor times (s) of each function, called in turns.

    A change of the machine's speed then affects all of them.  The first call of each, which fills
    the caches of disk, bytecode and processor, does not count.
    """
    all_times: list[list[float]] = [[] for _ in functions]
    for _ in range(rounds + 1):
        for function, times in zip(functions, all_times, strict=True):
            gc.collect()
            start = processor_time()
            function()
            times.append(processor_time() - start)
    return [times[1:] for times in all_times]


def is_compiled() -> bool:
    """Returns whether the control cycle is machine code; run the bench in build/compiled then."""
    driver = importlib.util.find_spec("thorvaldc.runtime.driver")
    return driver is not None and not str(driver.origin).endswith(".py")
