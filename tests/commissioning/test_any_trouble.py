"""Flashes of random robots, interrupted at random times, resumed and undone."""

from __future__ import annotations

import functools
import random
from collections.abc import Callable

import pytest

from tests.commissioning.bench import NODES, QUICK, Bench, Dead, four_drives
from tests.slow import mostly_exhaustive
from thorvaldc.commissioning.journal import Journal
from thorvaldc.diagnostics import DiagnosticError

IDS = (1, 2, 3, 4, 112, 30, 126, 77)
TROUBLES = 6


@pytest.mark.parametrize("seed", mostly_exhaustive(range(16), 4))
def test_no_id_is_ever_double_and_the_bus_ends_as_planned(seed: int) -> None:
    rng = random.Random(seed)
    ids = [255 if rng.random() < 0.25 else node for node in rng.sample(IDS, 4)]
    bench = troubled(rng, ids)
    assert not bench.watch.doubles, (seed, ids)


@pytest.mark.parametrize("seed", mostly_exhaustive(range(8), 3))
def test_existing_doubles_only_become_fewer(seed: int) -> None:
    """New drives with factory ids: only nodes that share an id at the start ever share one."""
    rng = random.Random(seed)
    ids = [rng.choice((1, 1, 2, 3, 9)) for _ in NODES]
    bench = troubled(rng, ids)
    sharing = {
        f"{a} and {b} at {i}"
        for a, i in zip(NODES, ids, strict=True)
        for b, j in zip(NODES, ids, strict=True)
        if i == j
    }
    assert set(bench.watch.doubles) <= sharing, (seed, ids)


def troubled(rng: random.Random, ids: list[int]) -> Bench:
    """Flashes until the end, with many interruptions."""
    kept = {name: {"node_id": node} for name, node in zip(NODES, ids, strict=True)}
    bench = Bench(four_drives(), kept, timing=QUICK, torn=rng.random() < 0.5)
    for _ in range(TROUBLES):
        power_on(bench)
        bench.wire.at_frame(bench.wire.frames + rng.randrange(1, 800), trouble(bench, rng))
        journal = Journal(bench.storage)
        if journal.unfinished:
            how = rng.choice([bench.resume, bench.resume, bench.rollback])
        else:
            how = rng.choice([bench.apply, bench.rollback]) if journal.runs else bench.apply
        attempt(how)
        bench.wire._at_frame.clear()
    bench.simulated.power_off()
    power_on(bench)
    for _ in range(3):  # a rollback must end before the next flash
        attempt(bench.resume if Journal(bench.storage).unfinished else bench.apply)
    assert [bench.devices()[name].node_id for name in NODES] == [1, 2, 3, 4]
    assert bench.plan().steps == ()
    return bench


def trouble(bench: Bench, rng: random.Random) -> Callable[[], object]:
    """Chooses an interruption: the power of all, of the bus or of a node, or the master's end."""
    device = bench.devices()[rng.choice(NODES)]
    later = functools.partial(
        bench.simulated.timeline.after, rng.randrange(30_000_000), device.power_off
    )

    def die() -> None:
        bench.interface.dead = True

    def cut() -> None:
        die()
        bench.interface.controller.switch_off()
        bench.simulated.power_off()

    return rng.choice([cut, die, bench.simulated.power_off, device.power_off, later])


def power_on(bench: Bench) -> None:
    bench.simulated.power_on()
    bench.simulated.run(0.15)


def attempt(how: Callable[[], object]) -> None:
    try:
        how()
    except (Dead, DiagnosticError):
        return
