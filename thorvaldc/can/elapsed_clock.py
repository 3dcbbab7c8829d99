"""The clock of everything that drives in real time: it also counts while the computer is asleep.

``time.monotonic`` of Linux stands while the computer is suspended.  A driver that reads it would go
on after an hour in a closed laptop as if no time had passed: no gap, a command that still counts,
and a ramp at a speed that the wheels no longer have.  Linux has ``CLOCK_BOOTTIME``, which counts.
``CLOCK_MONOTONIC`` of macOS and the clock of Windows count, too.

The programs of a computer share the clock: a simulated bus tells its clients when it has started.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from thorvaldc.can.nanoseconds import NANOSECONDS


def _counting_clock() -> Callable[[], int]:
    for name in ("CLOCK_BOOTTIME", "CLOCK_MONOTONIC"):
        number = getattr(time, name, None)
        if number is None:
            continue
        try:
            time.clock_gettime_ns(number)
        except OSError:  # an old kernel, or a sandbox that does not permit it
            continue
        return lambda: time.clock_gettime_ns(number)
    return time.monotonic_ns


elapsed_ns: Callable[[], int] = _counting_clock()
"""Returns the time (ns) of the clock, which never goes back; its zero has no meaning."""


def elapsed() -> float:
    """Returns the time (s) of the clock."""
    return elapsed_ns() / NANOSECONDS
