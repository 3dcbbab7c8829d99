"""Times in whole nanoseconds."""

NANOSECONDS = 1_000_000_000
NEVER = 1 << 62
"""A time (ns) after everything."""


def to_ns(seconds: float) -> int:
    return round(seconds * NANOSECONDS)
