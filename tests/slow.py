"""Parameters of tests: the first are quick, the others belong to the group `slow`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def mostly_slow(values: Iterable[Any], quick: int = 1) -> list[Any]:
    """Returns parameters of which all but the first ``quick`` have the marker `slow`."""
    parameters = list(values)
    slow = (pytest.param(value, marks=pytest.mark.slow) for value in parameters[quick:])
    return [*parameters[:quick], *slow]
