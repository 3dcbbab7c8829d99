"""Steps of many environments: in one batch, one after the other, and over processes."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

from bench.figure import EXAMPLE, Figure
from thorvaldc.simulation.worker_processes import processors
from thorvaldc.tools.gym import environments

ENVIRONMENTS, STEPS, ROUNDS = 16, 5, 15
MODES = ("sync", "vector_entry_point", "async")


def figures() -> Iterator[Figure]:
    many = {
        mode: gymnasium.make_vec(
            environments.NAME, ENVIRONMENTS, vectorization_mode=mode, file=EXAMPLE, duration=1e4
        )
        for mode in MODES
    }
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (ENVIRONMENTS, 3)).astype(np.float32)
    rates: dict[str, list[float]] = {mode: [] for mode in MODES}
    for envs in many.values():
        envs.reset(seed=1)
        _rate(envs, actions)
    for _ in range(ROUNDS):
        for mode, envs in many.items():
            rates[mode].append(_rate(envs, actions))
    share = _driver_share(many["vector_entry_point"].unwrapped, actions)
    for envs in many.values():
        envs.close()
    one = statistics.median(rates["sync"])
    for mode, name in (("vector_entry_point", "batch"), ("async", "processes")):
        ratios = [a / b for a, b in zip(rates[mode], rates["sync"], strict=True)]
        yield Figure(
            f"environments: {name}",
            statistics.median(ratios),
            "x",
            None,
            "higher",
            f"steps of {ENVIRONMENTS} environments of a 4WD4WS over time, relative to one after the"
            f" other in the same round ({one:.4g} robot-steps/s, each 0.1 s); median of {ROUNDS},"
            f" {min(ratios):.2f} to {max(ratios):.2f}, {processors()} processors",
        )
    yield Figure(
        "environments: driver",
        share,
        "",
        None,
        "lower",
        "share of the driver and Gymnasium in the processor time of a step of the batch; the"
        f" rest is physics, so that a batch is at most {1.0 / share:.2f} times as fast",
    )


def _rate(envs: Any, actions: Any) -> float:
    """Robot-steps per second."""
    start = time.perf_counter()
    for _ in range(STEPS):
        envs.step(actions)
    return ENVIRONMENTS * STEPS / (time.perf_counter() - start)


def _driver_share(envs: Any, actions: Any) -> float:
    physics_time, step = 0.0, envs.physics.step

    def timed_step(*arguments: Any) -> None:
        nonlocal physics_time
        start = time.process_time()
        step(*arguments)
        physics_time += time.process_time() - start

    envs.physics.step = timed_step
    start = time.process_time()
    for _ in range(3 * STEPS):
        envs.step(actions)
    return 1.0 - physics_time / (time.process_time() - start)
