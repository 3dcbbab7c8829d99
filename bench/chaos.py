"""Simulated hours of random missions with faults in a minute of computing time."""

from __future__ import annotations

import time
from collections.abc import Iterator

from bench.figure import Figure

GROUP = "long"

SEEDS = range(80)


def figures() -> Iterator[Figure]:
    from tests.chaos.chaos_robots import ROBOTS
    from tests.chaos.mission_generator import MissionGenerator
    from tests.chaos.seed_runner import prepared_world, run_schedule

    for robot in ROBOTS:
        prepared_world(robot)
    start = time.perf_counter()
    outcomes = [run_schedule(MissionGenerator(seed).schedule()) for seed in SEEDS]
    minutes = (time.perf_counter() - start) / 60.0
    hours = sum(outcome.seconds for outcome in outcomes) / 3600.0
    yield Figure(
        "chaos, simulated time",
        hours / minutes,
        "h/min",
        None,
        "higher",
        f"{len(outcomes)} missions with faults on four robots, one process; `make chaos`",
    )
    yield Figure(
        "chaos, violated invariants",
        sum(not outcome.holds for outcome in outcomes),
        "",
        0,
        "lower",
        "of the same missions",
    )
