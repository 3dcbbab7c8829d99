"""Judges the time between two control cycles.

A control cycle that comes too late is a problem of the base driver: its process was stopped, the
machine was busy, or a system call has blocked.  Meanwhile the watchdogs of the drives may have
braked the robot, and commands may have waited in a queue.  ``T`` is the period of the control
cycle, and ``W`` is the shortest watchdog of the robot's drives:

    0         1 T       2.5 T                       W / 2                          W
    |----------|----------|---------------------------|----------------------------|
          normal          |           short           |            long            drives brake

- After a **short** gap, the twist ramp restarts from the measured twist.  All commands that waited
  are void.  The robot moves again after a zero twist was commanded.
- A **long** gap is a fault.  The robot stops, and a person must reset the fault.

The factor 1/2 of a long gap leaves time for a last control cycle before the drives brake by
themselves: a drive may have heard the base driver for the last time up to one heartbeat period
before the gap.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.model.stopping import shortest_watchdog

NORMAL_PERIODS = 2.5
"""Longest normal time between two control cycles, in periods: one cycle is missing."""
WATCHDOG_SHARE = 0.5
"""Shortest long gap, as a share of the shortest watchdog of the drives."""
_ROUNDING = 1e-9


class Gap(enum.Enum):
    """Judgement of the time between two control cycles, see the text of this module."""

    NONE = "none"
    SHORT = "short"
    LONG = "long"


@dataclass(frozen=True, slots=True)
class TimeGapRule:
    """Limits (s) of the time between two control cycles.

    - ``normal``: longest time without a gap;
    - ``longest_short``: time from which on a gap is long.
    """

    normal: float
    longest_short: float

    @classmethod
    def of(cls, robot: Robot, settings: DriverSettings) -> TimeGapRule:
        """Returns the limits for a robot, from the watchdogs of its drives.

        For a robot whose drives have no watchdog, the command time-out replaces the watchdog.
        """
        watchdog = shortest_watchdog(robot)
        watchdog = settings.command_timeout if watchdog is None else watchdog
        normal = NORMAL_PERIODS / settings.rate
        return cls(normal, max(WATCHDOG_SHARE * watchdog, normal))

    def judge(self, elapsed: float) -> Gap:
        """Judges the time ``elapsed`` (s) between two control cycles."""
        if elapsed <= self.normal + _ROUNDING:
            return Gap.NONE
        return Gap.SHORT if elapsed < self.longest_short - _ROUNDING else Gap.LONG


def gap_text(elapsed: float) -> str:
    """Returns the reason that the operator sees, such as ``no control cycle for 120 ms``."""
    return f"no control cycle for {elapsed * 1000.0:.0f} ms"
