"""Parameters of tests in three groups: quick ones, `slow` ones and `exhaustive` ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def mostly_slow(values: Iterable[Any], quick: int = 1, slow: int | None = None) -> list[Any]:
    """Returns parameters: the first ``quick`` have no marker, the next ``slow`` (or all others) the
    marker `slow`, and the rest `exhaustive`."""
    parameters = list(values)
    last = len(parameters) if slow is None else quick + slow
    marks = [*[()] * quick, *[pytest.mark.slow] * (last - quick)]
    marks += [pytest.mark.exhaustive] * (len(parameters) - last)
    return [pytest.param(value, marks=mark) for value, mark in zip(parameters, marks, strict=False)]


def one_quick_of(step: int, values: Iterable[Any]) -> list[Any]:
    """Returns parameters in their order: the first of each ``step`` has no marker, the others have
    the marker `slow`.  Thus both groups have rows of all parts of a long table.

    A value that is a tuple has the values of several names.
    """
    rows = [value if type(value) is tuple else (value,) for value in values]
    return [
        pytest.param(*row, marks=[pytest.mark.slow] * (index % step > 0))
        for index, row in enumerate(rows)
    ]


def mostly_exhaustive(values: Iterable[Any], quick: int = 1) -> list[Any]:
    """Returns parameters of which all but the first ``quick`` have the marker `exhaustive`."""
    return mostly_slow(values, quick, slow=0)
