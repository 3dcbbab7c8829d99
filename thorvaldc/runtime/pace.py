"""When the control cycles of a robot are due, which gaps between them stop it, and what ends a run.

The cycles start at absolute deadlines, one per period T, so that timing errors do not accumulate.
If a cycle takes longer than T, the missed deadlines are skipped::

    deadlines   |--------|--------|--------|--------|
    work        [##]     [################]         [##]
                           overrun: 1      skipped: 1

The time of the robot is that of its clock: a CAN interface, whose time goes on by itself or is
virtual, or ``SimulatedTime``.  Virtual and simulated time go on only when a cycle begins, at
``factor`` times the real time.  Missed cycles are not caught up, except for ``backlog``: the robot
stands still meanwhile.
"""

from __future__ import annotations

import contextlib
import enum
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, Protocol

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.model.stopping import shortest_watchdog
from thorvaldc.runtime.mypyc_marks import mypyc_attr


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
    - ``gaps``: number of gaps in time between two cycles, see ``Gap``.
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


@mypyc_attr(allow_interpreted_subclasses=True)
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
        self.backlog = 0.0
        """Longest delay (s) of virtual time that is caught up."""
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
            self._due = max(self._due + real_period, self.real_time() - self.backlog)
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


# -- gaps: the time between two control cycles --------------------------------------------------
#
# A control cycle that comes too late is a problem of the base driver: its process was stopped, the
# machine was busy, or a system call has blocked.  Meanwhile the watchdogs of the drives may have
# braked the robot, and commands may have waited in a queue.  ``T`` is the period of the control
# cycle, and ``W`` is the shortest watchdog of the robot's drives:
#
#     0         1 T       2.5 T                       W / 2                          W
#     |----------|----------|---------------------------|----------------------------|
#           normal          |           short           |            long            drives brake
#
# - After a **short** gap, the twist ramp goes on to zero by the whole time of the gap, or from the
#   measured twist if the drives have braked more.  All commands that waited are void.  The robot
#   moves again after a zero twist was commanded.
# - A **long** gap is a fault.  The robot stops, and a person must reset the fault.
# - ``MOST_GAPS`` short gaps within ``GAP_WINDOW`` count as a long one: a computer that misses its
#   control cycles again and again does not control a robot.
#
# The factor 1/2 of a long gap leaves time for a last control cycle before the drives brake by
# themselves: a drive may have heard the base driver for the last time up to one heartbeat period
# before the gap.

NORMAL_PERIODS: Final = 2.5
"""Longest normal time between two control cycles, in periods: one cycle is missing."""
WATCHDOG_SHARE: Final = 0.5
"""Shortest long gap, as a share of the shortest watchdog of the drives."""
MOST_GAPS: Final = 3
"""Number of short gaps within ``GAP_WINDOW`` that count as a long gap."""
GAP_WINDOW: Final = 2.0
"""Time (s) in which short gaps are counted."""
_ROUNDING: Final = 1e-9


class Gap(enum.Enum):
    """Judgement of the time between two control cycles, see the text of this module."""

    NONE = "none"
    SHORT = "short"
    LONG = "long"


@dataclass(slots=True)
class TimeGapRule:
    """Limits (s) of the time between two control cycles, and the latest short gaps.

    - ``normal``: longest time without a gap;
    - ``longest_short``: time from which on a gap is long;
    - ``latest``: times (s) of the newest gaps.
    """

    normal: float
    longest_short: float
    latest: tuple[float, ...] = ()

    @classmethod
    def of(cls, robot: Robot, settings: DriverSettings, normal: float | None = None) -> TimeGapRule:
        """Returns the limits for a robot, from the watchdogs of its drives.

        For a robot whose drives have no watchdog, the command time-out replaces the watchdog.
        ``normal``: longest time (s) without a gap, if it does not follow from the control cycle.
        """
        rule = cls.without_watchdog(settings)
        watchdog = shortest_watchdog(robot)
        longest = rule.longest_short if watchdog is None else WATCHDOG_SHARE * watchdog
        normal = rule.normal if normal is None else normal
        return cls(normal, max(longest, normal))

    @classmethod
    def without_watchdog(cls, settings: DriverSettings) -> TimeGapRule:
        """Returns the limits for a robot whose joints keep their last commands."""
        normal = NORMAL_PERIODS / settings.rate
        return cls(normal, max(WATCHDOG_SHARE * settings.command_timeout, normal))

    def judge(self, elapsed: float, now: float = math.inf) -> Gap:
        """Judges the time ``elapsed`` (s) between two control cycles, of which one begins at
        ``now`` (s)."""
        if elapsed <= self.normal + _ROUNDING:
            return Gap.NONE
        recent = sum(1 for time in self.latest if now - time < GAP_WINDOW)
        if elapsed >= self.longest_short - _ROUNDING or recent >= MOST_GAPS - 1:
            return Gap.LONG
        return Gap.SHORT

    def note(self, now: float) -> None:
        """Counts a gap that has ended at ``now`` (s)."""
        self.latest = (*self.latest[1 - MOST_GAPS :], now)


def gap_text(elapsed: float) -> str:
    """Returns the reason that the operator sees, such as ``no control cycle for 120 ms``."""
    return f"no control cycle for {elapsed * 1000.0:.0f} ms"


# -- signals that end a run: the program stops the robot in order, and ends then ----------------

END_SIGNALS: Final = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if name in signal.Signals.__members__
)
"""All signals with which a person, a terminal that closes, or the system ends a program."""


@contextlib.contextmanager
def end_signals() -> Iterator[Callable[[], bool]]:
    """Yields a function that returns true after one of the signals ``END_SIGNALS`` was received.

    Further signals change nothing, so that they do not cut off the stop of the robot, which belongs
    into the ``with`` block.  SIGHUP stays ignored where the program was started to outlive its
    terminal (``nohup``).  Outside the main thread no signal is received, because Python runs signal
    handlers only in the main thread.
    """
    received: list[int] = []
    previous = {}
    if threading.current_thread() is threading.main_thread():
        for number in END_SIGNALS:
            if number.name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN:
                continue
            previous[number] = signal.signal(number, lambda number, frame: received.append(number))
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
