"""The clock that counts while the computer is asleep."""

from __future__ import annotations

import time

import pytest

from tests.can.interfaces import bus as bus
from tests.can.interfaces import open_python_can
from thorvaldc.can.frame import NANOSECONDS, counting_clock, elapsed, elapsed_ns
from thorvaldc.model import Bus

CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Linux counts the sleep with a clock of its own, other systems with the monotonic one."""


def test_it_counts_the_sleep_of_the_computer() -> None:
    """On a computer that has slept, the clock is ahead of ``time.monotonic``."""
    before = time.clock_gettime_ns(CLOCK)
    assert before <= elapsed_ns() <= time.clock_gettime_ns(CLOCK)
    assert before / 1e9 <= elapsed() <= time.clock_gettime_ns(CLOCK) / 1e9


def test_an_hour_of_sleep_is_an_hour_for_a_real_bus(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = open_python_can("virtual:asleep", bus)
    read = time.clock_gettime_ns
    before = interface.now

    def after_an_hour(clock: int) -> int:
        return read(clock) + (3600 * NANOSECONDS if clock == CLOCK else 0)

    monkeypatch.setattr(time, "clock_gettime_ns", after_an_hour)
    assert interface.now - before == pytest.approx(3600.0, abs=1.0)
    interface.close()


def test_a_system_that_refuses_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(clock: int) -> int:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(time, "clock_gettime_ns", refuse)
    assert counting_clock() is time.monotonic_ns
