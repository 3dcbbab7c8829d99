"""Sums of floats that do not depend on the version of Python; compiled with the runtime."""

from __future__ import annotations

from collections.abc import Iterable


def float_sum(values: Iterable[float]) -> float:
    """Returns the sum of the values, added from left to right with one rounding per addition.

    The builtin ``sum`` does the same on Python 3.11, but compensates the rounding errors since
    Python 3.12: the last digits of its result depend on the version of Python.  ``math.fsum`` is
    correctly rounded on every version, but raises an exception for sums that are not finite.
    """
    total = 0.0
    for value in values:
        total += value
    return total
