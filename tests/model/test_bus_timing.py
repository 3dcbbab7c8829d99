"""Load and worst-case response times: published examples, and the rules for a robot's bus."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Sequence

import pytest

from tests.robots import SPAN
from thorvaldc.model import Bus, FrameDefinition
from thorvaldc.model.bus_timing import (
    Stream,
    bus_load,
    frame_response_times,
    response_times,
    worst_case_bits,
)

MS, US = 1e-3, 1e-6


def test_worst_case_bits_of_a_frame() -> None:
    assert [worst_case_bits(n) for n in (0, 1, 8)] == [55, 65, 135]


def test_the_published_example_that_refuted_the_first_instance() -> None:
    """Davis et al. 2007, section 3.2: the second instance of C has the longest response time."""
    streams = [Stream(1, 125, 2.5 * MS), Stream(2, 125, 3.5 * MS), Stream(3, 125, 3.5 * MS)]
    bounds = response_times(streams, 125_000)
    assert bounds == pytest.approx([2 * MS, 3 * MS, 3.5 * MS])
    # only the order of the identifiers matters, not that of the list
    assert response_times(streams[::-1], 125_000) == bounds[::-1]


def test_the_most_urgent_frame_waits_for_the_longest_other() -> None:
    bounds = response_times([Stream(1, 55, 1.0), Stream(9, 135, 1.0), Stream(5, 65, 1.0)], 500_000)
    assert bounds[0] == pytest.approx((135 + 55) * 2e-6)
    assert bounds[2] == pytest.approx((135 + 55 + 65) * 2e-6)
    assert bounds[1] == pytest.approx((55 + 65 + 135) * 2e-6)


def test_jitter_adds_up_and_lets_two_frames_follow_each_other() -> None:
    late = [Stream(1, 100, 10 * MS, 9.9 * MS), Stream(2, 100, 10 * MS)]
    first, second = response_times(late, 1_000_000)
    assert first == pytest.approx((9.9 + 0.2) * MS)
    assert second == pytest.approx(0.3 * MS)  # two of the first frame, then one of the second


def test_a_group_sends_one_frame_in_a_period() -> None:
    apart = [Stream(1, 100, 0.02), Stream(2, 130, 0.02), Stream(3, 100, 0.02)]
    together = [s._replace(group="g") if s.identifier < 3 else s for s in apart]
    assert response_times(apart, 1_000_000)[2] == pytest.approx(0.33 * MS)
    assert response_times(together, 1_000_000)[2] == pytest.approx(0.23 * MS)


def test_no_bound_where_the_bus_is_full() -> None:
    streams = [Stream(1, 100, 0.2 * MS), Stream(2, 100, 0.2 * MS), Stream(3, 100, 1.0)]
    bounds = response_times(streams, 1_000_000)
    assert bounds[0] is not None
    assert bounds[1:] == [None, None]


def test_a_cycle_that_reaches_into_the_next() -> None:
    """Cycles of 1 ms; a report of 100 us is up to 0.95 ms late, 50 us before the next command."""
    report = Stream(1, 100, 1 * MS, 0.95 * MS, stage=2)
    command, other = Stream(2, 100, 1 * MS, stage=0), Stream(3, 100, 50 * MS)
    bounds = response_times([report, command, other], 1_000_000)
    # a blocking frame, the late report, the command; the report of its own cycle comes after it
    assert bounds[1] == pytest.approx((0.3 - 0.05) * MS)
    # a frame outside of the cycle may have to wait for both reports and the command
    assert bounds[2] == pytest.approx(0.40 * MS)
    apart = [s._replace(stage=None) for s in (report, command, other)]
    assert response_times(apart, 1_000_000)[1] == pytest.approx(0.4 * MS)


@pytest.mark.parametrize("seed", range(20))
def test_bounds_hold_in_a_small_simulation(seed: int) -> None:
    """Frames with random offsets on an ideal bus keep the bound; the last nearly reaches it."""
    generator = random.Random(seed)
    count, bitrate = generator.randint(3, 12), 500_000
    streams = [
        Stream(i, worst_case_bits(generator.randint(0, 8)), generator.choice((5, 10, 20, 50)) * MS)
        for i in range(count)
    ]
    bounds = response_times(streams, bitrate)
    seen = [0.0] * count
    for case in range(40):
        offsets = [0 if case == 0 else generator.randrange(round(s.period / US)) for s in streams]
        for i, delay in enumerate(_simulated(streams, offsets, 2)):
            seen[i] = max(seen[i], delay * US)
    for bound, delay in zip(bounds, seen, strict=True):
        assert bound is not None
        assert delay <= bound + 1e-12
    # if all are due together, the last waits for all others: the bound has no margin
    assert seen[-1] == pytest.approx(bounds[-1], rel=0.05)


def _simulated(streams: Sequence[Stream], offsets: Sequence[int], bit: int) -> list[int]:
    """Return the longest delay (us) of each stream in 0.2 s on an ideal bus."""
    due = sorted(
        (offset + n * round(stream.period / US), i)
        for i, (stream, offset) in enumerate(zip(streams, offsets, strict=True))
        for n in range(int(0.2 / stream.period))
    )
    worst, waiting, now = [0] * len(streams), list[tuple[int, int, int]](), 0
    while due or waiting:
        if not waiting:
            now = max(now, due[0][0])
        while due and due[0][0] <= now:
            at, i = due.pop(0)
            waiting.append((streams[i].identifier, at, i))
        waiting.sort()
        _, at, i = waiting.pop(0)
        now += streams[i].bits * bit
        worst[i] = max(worst[i], now - at)
    return worst


# -- a robot's bus ----------------------------------------------------------------------


def frame(
    cob_id: int, kind: str = "pdo", producer: str = "n", **changes: object
) -> FrameDefinition:
    consumer = "n" if producer == "master" else "master"
    plain = FrameDefinition(
        f"f{cob_id:x}", cob_id, kind, producer, (consumer,), 8, None, None, (), SPAN
    )
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


def bus(*frames: FrameDefinition) -> Bus:
    return Bus("main", 500_000, 0.02, (), frames, SPAN)


LENGTH = 135 * 2e-6
SYNC = frame(0x080, "sync", "master", length=0, period=0.02)
SYNC_LENGTH = 55 * 2e-6


def test_sync_follows_the_commands_and_synchronous_frames_follow_sync() -> None:
    commands = [frame(0x201 + i, producer="master", period=0.02) for i in range(3)]
    report = frame(0x181, period=0.02, synchronous=True)
    times = frame_response_times(bus(SYNC, *commands, report))
    late = [times[f.name] for f in commands]
    # two commands precede the last one; SYNC and the report of the previous cycle are finished
    assert late[-1] == pytest.approx(3 * LENGTH, abs=1e-9)
    # the analysis assumes that a report that is late by one cycle can delay SYNC
    assert times[SYNC.name] == pytest.approx(max(t for t in late if t) + LENGTH + SYNC_LENGTH)
    assert times[report.name] == pytest.approx(times[SYNC.name] + 2 * LENGTH)
    # a frame that does not wait for SYNC has no jitter, and can be due at any time
    alone = frame_response_times(
        bus(SYNC, *commands, dataclasses.replace(report, synchronous=False))
    )
    assert alone[report.name] == pytest.approx(2 * LENGTH + SYNC_LENGTH)


def test_frames_on_demand_are_one_a_cycle_together() -> None:
    requests = [
        frame(0x000, "nmt", "master", length=2),
        frame(0x301, producer="master"),
        frame(0x601, "sdo", "master"),
        frame(0x602, "sdo", "master"),
        frame(0x581, "sdo"),
        frame(0x582, "sdo"),
    ]
    beat = frame(0x701, "heartbeat", length=1, period=0.1)
    times = frame_response_times(bus(*requests, beat))
    # one request; two answers, if one is late and the next is early
    assert times[beat.name] == pytest.approx(3 * LENGTH + 65 * 2e-6)
    assert bus_load(bus(*requests)) == pytest.approx(2 * LENGTH / 0.02)


def test_relayed_frames_come_at_their_limit() -> None:
    relayed = frame(0x190, "relay", minimum_interval=0.005)
    assert bus_load(bus(relayed)) == pytest.approx(LENGTH / 0.005)
    other, blocker = frame(0x200, period=0.02), frame(0x300, period=0.02)
    slow, quick = (
        frame_response_times(
            bus(dataclasses.replace(relayed, minimum_interval=interval), other, blocker)
        )[other.name]
        for interval in (0.005, 0.0004)
    )
    assert slow == pytest.approx(3 * LENGTH)
    assert quick == pytest.approx(5 * LENGTH)  # three relayed frames precede it


def test_a_full_bus_has_no_bounds() -> None:
    crowd = [frame(0x181 + i, period=0.001) for i in range(8)]
    assert set(frame_response_times(bus(SYNC, *crowd)).values()) >= {None}
    assert frame_response_times(bus()) == {}
