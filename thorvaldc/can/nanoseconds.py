"""Converts times to whole nanoseconds, so that the simulated time has no rounding errors."""

from __future__ import annotations

NANOSECONDS = 1_000_000_000
"""Nanoseconds in one second."""
NEVER = 1 << 62
"""A time (ns) that is later than the time of every event."""


def to_ns(seconds: float) -> int:
    return round(seconds * NANOSECONDS)
