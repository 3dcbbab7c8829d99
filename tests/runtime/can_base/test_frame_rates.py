"""The count of frames against their stated period, at times of reception that the tests choose."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest

from tests.simulation.bus.robots import roboteq
from thorvaldc.runtime.can_base.frame_receiver import LONGEST_BURST, FrameRates, LatestFrame

CYCLE = 0.02
REPORT = 0x181
"""Report with a period of 20 ms."""


def first_alarm(
    stamps: Sequence[float], arrivals: Sequence[float] | None = None, end: float = 20.0
) -> float | None:
    """Returns the time (s) at which the count reports too many frames, ``None`` if it never does.

    ``stamps``: times of reception of the frames.  ``arrivals``: times at which the program gets the
    frames; by default the times of reception.
    """
    latest: dict[int, LatestFrame] = {}
    rates = FrameRates(roboteq().buses[0], ["fl_controller"], latest, {})
    waiting = sorted(zip(arrivals or stamps, stamps, strict=True))
    number = 0
    for cycle in range(round(end / CYCLE)):
        now = cycle * CYCLE + 0.001
        while number < len(waiting) and waiting[number][0] <= now:
            number += 1
            latest[REPORT] = LatestFrame(waiting[number - 1][1], b"", number)
        rates.take_sample()
        if rates.excessive:
            return now
    return None


def periodic(period: float, start: float = 0.0, end: float = 20.0) -> list[float]:
    return [start + i * period for i in range(round((end - start) / period))]


def test_frames_at_the_stated_rate() -> None:
    assert first_alarm(periodic(CYCLE)) is None
    assert first_alarm(periodic(CYCLE / 1.009)) is None
    assert first_alarm(periodic(2.0 * CYCLE)) is None


@pytest.mark.parametrize(("share", "limit"), [(1.0, 0.25), (0.5, 0.4), (0.1, 1.5), (0.03, 8.0)])
def test_additional_frames(share: float, limit: float) -> None:
    start = 5.0
    stamps = sorted([*periodic(CYCLE), *periodic(CYCLE / share, start + 0.003)])
    alarm = first_alarm(stamps)
    assert alarm is not None
    assert start < alarm < start + limit


@pytest.mark.parametrize("seed", range(5))
def test_jitter_and_lost_frames(seed: int) -> None:
    noise = random.Random(seed)
    stamps = [t + noise.uniform(0.0, 0.9 * CYCLE) for t in periodic(CYCLE)]
    kept = [t for t in stamps if noise.random() > 0.2]
    assert first_alarm(sorted(stamps)) is None
    assert first_alarm(sorted(kept)) is None


@pytest.mark.parametrize("seed", range(20))
def test_frames_that_come_in_bursts(seed: int) -> None:
    """An adapter holds the frames back, and stamps each when it delivers it; cycles run on.

    The delivery of a burst takes several cycles, so that a sample can end in the middle of it.
    """
    noise = random.Random(seed)
    stamps: list[float] = []
    held_until = 0.0
    for time in periodic(CYCLE):
        if noise.random() < 0.02 and time > held_until:
            held_until = time + noise.uniform(0.0, LONGEST_BURST)
        late = held_until + noise.uniform(0.0, 0.03) if time < held_until else time
        stamps.append(max(late, stamps[-1] if stamps else 0.0))
    assert first_alarm(stamps) is None


def test_a_late_program_does_not_count_its_own_delay() -> None:
    """The kernel stamps the frames; the program reads those of 0.2 s in one cycle."""
    stamps = periodic(CYCLE)
    arrivals = [0.2 * (int(t / 0.2) + 1) for t in stamps]
    assert first_alarm(stamps, arrivals) is None
    twice = sorted([*stamps, *periodic(CYCLE, 5.0)])
    alarm = first_alarm(twice, [0.2 * (int(t / 0.2) + 1) for t in twice])
    assert alarm is not None
    assert 5.0 < alarm < 5.5


def test_a_burst_hides_a_second_device_only_for_a_short_time() -> None:
    held = [t for t in periodic(CYCLE) if not 4.0 < t < 4.9]
    alarm = first_alarm(sorted([*held, *periodic(CYCLE, 5.0)]))
    assert alarm is not None
    assert alarm < 5.5
