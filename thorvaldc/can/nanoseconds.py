"""Times in whole nanoseconds: simulated time is exact, without the rounding of floats."""

from __future__ import annotations

NANOSECONDS = 1_000_000_000
"""ns in a second."""
NEVER = 1 << 62
"""A time (ns) later than every event."""


def to_ns(seconds: float) -> int:
    return round(seconds * NANOSECONDS)
