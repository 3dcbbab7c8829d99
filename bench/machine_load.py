"""Whether the machine is too busy to judge a time: a loop of known work on every core."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass

LOOP = """
import time
fastest, wall, processor = 1e9, time.perf_counter(), time.process_time()
for _ in range(12):
    start = time.process_time()
    for i in range(150_000):
        i & 7
    fastest = min(fastest, time.process_time() - start)
print(fastest, (time.process_time() - processor) / (time.perf_counter() - wall))
"""
LEAST_SHARE = 0.9
"""Share of the time in which a loop had a core, below which other programs took it away."""
SLOWEST = 1.2
"""Time of a loop over the shortest one of the bench, above which the core itself was slower."""
VALID = 2.0
"""Time (s) for which the loops need not run again."""


@dataclass(frozen=True)
class MachineLoad:
    """The worst of all cores: ``share`` of a core that a loop had, ``slowdown`` of the loop."""

    share: float
    slowdown: float

    @property
    def is_busy(self) -> bool:
        return self.share < LEAST_SHARE or self.slowdown > SLOWEST

    def __str__(self) -> str:
        return (
            f"a known loop had {100 * self.share:.0f} % of a core"
            f" and took {self.slowdown:.2f} times its least time"
        )


class LoadMeter:
    """Runs the loops between the figures, and compares them with the fastest ones before."""

    def __init__(self) -> None:
        self._fastest = float("inf")
        self._time = float("-inf")
        self._load = MachineLoad(1.0, 1.0)
        for _ in range(3):  # the first loops also find the speed of the machine
            self._measure()

    def since_last(self) -> MachineLoad:
        """Returns the worse load of the last call and of now."""
        before = self._load
        if time.perf_counter() - self._time > VALID:
            self._measure()
        return MachineLoad(
            min(before.share, self._load.share), max(before.slowdown, self._load.slowdown)
        )

    def _measure(self) -> None:
        command = [sys.executable, "-I", "-S", "-c", LOOP]
        loops = [
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            for _ in range(os.cpu_count() or 1)
        ]
        numbers = [tuple(map(float, loop.communicate()[0].split())) for loop in loops]
        self._fastest = min(self._fastest, *(fastest for fastest, _ in numbers))
        self._load = MachineLoad(
            min(share for _, share in numbers),
            max(fastest for fastest, _ in numbers) / self._fastest,
        )
        self._time = time.perf_counter()
