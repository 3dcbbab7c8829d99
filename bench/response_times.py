"""Worst-case response times of the budget beside a simulated bus that does its worst."""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from bench.bus_traffic import random_bus, reached
from bench.figure import Figure

BUSES, SEEDS = 30, 30


def figures() -> Iterator[Figure]:
    found = [reached(random_bus(number), SEEDS) for number in range(BUSES)]
    most = max(max(r.of_sent.values()) for r in found)
    best = [max(r.of_bound.values()) for r in found]
    last = [r.of_bound[r.last] for r in found]
    last_sent = [r.of_sent[r.last] for r in found]
    frames = sum(len(r.of_bound) for r in found)
    yield Figure(
        "response time over its bound",
        most,
        "",
        1.0,
        "lower",
        f"the most of {frames} frames on {BUSES} random buses x {SEEDS} seeds, simulated wire;"
        " the bound for the very bits that were sent, which is below that of the budget",
    )
    yield Figure(
        "response bound that is reached",
        min(best),
        "",
        0.95,
        "higher",
        "of the budget's bound, by the frame of each bus that comes nearest: least of the buses"
        f" (median {statistics.median(best):.3f})",
    )
    yield Figure(
        "the same by the last frame",
        statistics.median(last),
        "",
        None,
        "higher",
        "the least urgent periodic frame, which waits for all others: median of the buses"
        f" (least {min(last):.3f}); by the very bits sent {statistics.median(last_sent):.3f},"
        f" at least 0.95 on {sum(x >= 0.95 for x in last_sent)} of {BUSES} buses",
    )
