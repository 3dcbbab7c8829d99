"""Signals: the numbers that their bits can hold."""

from __future__ import annotations

import sys

from thorvaldc.model import Signal
from thorvaldc.model.bus import FLOAT32_MAX


def test_the_range_of_raw_values() -> None:
    assert Signal("s", 0, 8).raw_range == (0, 255)
    assert Signal("s", 0, 8, signed=True).raw_range == (-128, 127)
    assert Signal("s", 0, 1, signed=True).raw_range == (-1, 0)
    assert Signal("s", 0, 32, floating_point=True).raw_range == (-FLOAT32_MAX, FLOAT32_MAX)
    largest = sys.float_info.max
    assert Signal("s", 0, 64, floating_point=True).raw_range == (-largest, largest)
