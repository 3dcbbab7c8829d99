"""Judges the time between two control cycles.

A control cycle that comes too late is a problem of the base driver: its process was stopped, the
machine was busy, or a system call has blocked.  Meanwhile the watchdogs of the drives may have
braked the robot, and commands may have waited in a queue.  ``T`` is the period of the control
cycle, and ``W`` is the shortest watchdog of the robot's drives:

    0         1 T       2.5 T                       W / 2                          W
    |----------|----------|---------------------------|----------------------------|
          normal          |           short           |            long            drives brake

- After a **short** gap, the twist ramp goes on to zero by the whole time of the gap, or from the
  measured twist if the drives have braked more.  All commands that waited are void.  The robot
  moves again after a zero twist was commanded.
- A **long** gap is a fault.  The robot stops, and a person must reset the fault.
- ``MOST_GAPS`` short gaps within ``GAP_WINDOW`` count as a long one: a computer that misses its
  control cycles again and again does not control a robot.

The factor 1/2 of a long gap leaves time for a last control cycle before the drives brake by
themselves: a drive may have heard the base driver for the last time up to one heartbeat period
before the gap.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.model.stopping import shortest_watchdog

NORMAL_PERIODS = 2.5
"""Longest normal time between two control cycles, in periods: one cycle is missing."""
WATCHDOG_SHARE = 0.5
"""Shortest long gap, as a share of the shortest watchdog of the drives."""
MOST_GAPS = 3
"""Number of short gaps within ``GAP_WINDOW`` that count as a long gap."""
GAP_WINDOW = 2.0
"""Time (s) in which short gaps are counted."""
_ROUNDING = 1e-9


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
    def of(cls, robot: Robot, settings: DriverSettings) -> TimeGapRule:
        """Returns the limits for a robot, from the watchdogs of its drives.

        For a robot whose drives have no watchdog, the command time-out replaces the watchdog.
        """
        watchdog = shortest_watchdog(robot)
        watchdog = settings.command_timeout if watchdog is None else watchdog
        normal = NORMAL_PERIODS / settings.rate
        return cls(normal, max(WATCHDOG_SHARE * watchdog, normal))

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
