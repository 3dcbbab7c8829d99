"""When the control cycles of a robot are due.

The cycles start at absolute deadlines, one per period T, so that timing errors do not accumulate.
If a cycle takes longer than T, the missed deadlines are skipped::

    deadlines   |--------|--------|--------|--------|
    work        [##]     [################]         [##]
                           overrun: 1      skipped: 1

The time of the robot is that of its clock: a CAN interface, whose time goes on by itself or is
virtual, or ``SimulatedTime``.  Virtual and simulated time go on only when a cycle begins, at
``factor`` times the real time.  Missed cycles are not caught up: the robot stands still meanwhile.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol


class Clock(Protocol):
    """Time (s) of a robot."""

    @property
    def now(self) -> float: ...

    def sleep_until(self, time: float) -> None:
        """Waits until ``now`` is ``time``; a clock of virtual time advances to it."""


class SimulatedTime:
    """Time (s) of a simulation, which goes on with its control cycles only."""

    def __init__(self) -> None:
        self.now = 0.0

    def sleep_until(self, time: float) -> None:
        self.now = max(self.now, time)


@dataclass(slots=True)
class Timing:
    """Statistics of the timing of the control loop.

    - ``cycles``: number of control cycles.
    - ``overruns``: number of control cycles that ended after the next deadline.
    - ``skipped``: number of deadlines that the loop skipped because of overruns.
    - ``latest``: longest delay (s) between a deadline and the start of its cycle.
    - ``longest``: longest duration (s) of a cycle.
    - ``gaps``: number of gaps in time between two cycles, see ``time_gap``.
    """

    cycles: int = 0
    overruns: int = 0
    skipped: int = 0
    latest: float = 0.0
    longest: float = 0.0
    gaps: int = 0
    latest_gap: tuple[float, float] | None = None
    """End (s) and duration (s) of the latest gap."""
    starts: list[float] = field(default_factory=list)
    """Start times (s) of the cycles.  Recorded only with ``keep_starts``."""


class Pace:
    """The deadlines of the control cycles of a robot.

    - ``clock``: time of the robot;
    - ``period``: time (s) from one control cycle to the next;
    - ``factor``: ``None`` if the clock goes on by itself; else the speed of the virtual time
      relative to the real time, 0 for as fast as possible;
    - ``real_time``, ``sleep``: clock of the real time (s), and the function that waits.
    """

    def __init__(
        self,
        clock: Clock,
        period: float,
        factor: float | None = None,
        *,
        real_time: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        keep_starts: bool = False,
    ) -> None:
        self.clock = clock
        self.period = period
        self.factor = factor
        self.timing = Timing()
        self.real_time = real_time
        self._sleep = sleep
        self._keep_starts = keep_starts
        self._deadline: float | None = None
        self._due = real_time()

    @property
    def deadline(self) -> float:
        """Time (s) of the robot at which the next control cycle is due."""
        if self._deadline is not None:
            return self._deadline
        return self.clock.now if self.factor is None else self.clock.now + self.period

    def wait(self) -> float:
        """Returns the real time (s) until the next control cycle is due."""
        if self.factor is None:
            return self.deadline - self.clock.now
        return self._due - self.real_time()

    @property
    def lateness(self) -> float:
        """Real time (s) by which the next cycle is late while the virtual time stands still."""
        return self.real_time() - self._due if self.factor and self.timing.cycles else 0.0

    def sleep(self) -> None:
        """Waits until the next control cycle is due."""
        if self.factor is None:
            self.clock.sleep_until(self.deadline)
        elif (wait := self.wait()) > 0.0:
            self._sleep(wait)

    def begin(self) -> float:
        """Begins the control cycle that is due, and returns its time (s)."""
        timing, deadline = self.timing, self.deadline
        if self.factor is not None:
            self.clock.sleep_until(deadline)
            real_period = self.period / self.factor if self.factor else 0.0
            self._due = max(self._due + real_period, self.real_time())
        now = self.clock.now
        timing.cycles += 1
        timing.latest = max(timing.latest, now - deadline)
        if self._keep_starts:
            timing.starts.append(now)
        self._deadline = deadline
        return now

    def end(self, begun: float) -> None:
        """Ends the control cycle that has ``begun`` at that time (s)."""
        timing, end = self.timing, self.clock.now
        timing.longest = max(timing.longest, end - begun)
        deadline = self.deadline + self.period
        if end > deadline:
            skipped = math.ceil((end - deadline) / self.period)
            timing.overruns += 1
            timing.skipped += skipped
            deadline += skipped * self.period
        self._deadline = deadline

    def restart(self) -> None:
        """Lets the next cycle be due now, after a pause or before the end of a run."""
        self._deadline, self._due = None, self.real_time()
