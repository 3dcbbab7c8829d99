"""Worst-case response times of the bus budget, compared with the worst simulated traffic."""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from bench.bus_traffic import random_bus, reached
from bench.figure import Figure

GROUP = "long"

BUSES, SEEDS = 30, 30


def figures() -> Iterator[Figure]:
    results = [reached(random_bus(number), SEEDS) for number in range(BUSES)]
    highest = max(max(result.of_sent.values()) for result in results)
    best = [max(result.of_bound.values()) for result in results]
    last = [result.of_bound[result.last] for result in results]
    last_sent = [result.of_sent[result.last] for result in results]
    frames = sum(len(result.of_bound) for result in results)
    yield Figure(
        "response time over its bound",
        highest,
        "",
        1.0,
        "lower",
        f"maximum of {frames} frames on {BUSES} random buses x {SEEDS} seeds, simulated wire;"
        " bound with the exact bits sent, which is below that of the budget",
    )
    yield Figure(
        "response bound that is reached",
        min(best),
        "",
        0.95,
        "higher",
        "share of the budget's bound that the closest frame of each bus reaches: least of the buses"
        f" (median {statistics.median(best):.3f})",
    )
    yield Figure(
        "the same by the last frame",
        statistics.median(last),
        "",
        None,
        "higher",
        "the least urgent periodic frame, which waits for all others: median of the buses"
        f" (least {min(last):.3f}); with the exact bits {statistics.median(last_sent):.3f},"
        f" at least 0.95 on {sum(x >= 0.95 for x in last_sent)} of {BUSES} buses",
    )
