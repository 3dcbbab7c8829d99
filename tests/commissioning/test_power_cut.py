"""Power cuts at any time: after a resume the bus is as planned, and no id was ever double.

Four new nodes are flashed, two without an id, two with each other's.  Ids are watched at every
change of theirs, in the simulated devices themselves.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import pytest

from tests.commissioning.bench import NODES, QUICK, SWAPPED, Bench, Dead, MemoryStorage, four_drives
from tests.simulation.bus.robots import cia402_robot
from tests.slow import mostly_slow
from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.journal import Journal
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot

CHUNKS = 24


def chunks() -> list[Any]:
    """Returns the parts of the frames: the first one is quick, and CI has half of them.

    These are two neighbours of four, as requests and responses come by turns.
    """
    groups = [pytest.mark.slow] * 2 + [pytest.mark.exhaustive] * 2
    marked = [pytest.param(chunk, marks=groups[chunk % 4]) for chunk in range(1, CHUNKS)]
    return [0, *marked]


def new(robot: Robot | None = None, torn: bool = False) -> Bench:
    return Bench(robot or four_drives(), SWAPPED, timing=QUICK, torn=torn)


@functools.cache
def undisturbed(library: bool = False) -> tuple[str, int, int, dict[str, Any], bytes]:
    """Returns hash of the plan, first and last frame of the flash, memories, and journal."""
    robot = cia402_robot() if library else four_drives()
    hash_ = new(robot).plan().hash
    bench = new(robot)
    first = bench.wire.frames + 1
    bench.apply(hash_)
    ids = {name: bench.state()[name][0] for name in NODES}
    assert list(ids.values()) == [1, 2, 3, 4]
    assert not bench.watch.doubles
    return hash_, first, bench.wire.frames, bench.state(), bench.storage.data


def cut_power(bench: Bench) -> None:
    """Cuts the power of the whole robot, including its computer."""
    bench.interface.dead = True
    bench.interface.controller.switch_off()
    bench.simulated.power_off()


def kill_master(bench: Bench) -> None:
    bench.interface.dead = True


def cut_bus(bench: Bench) -> None:
    bench.simulated.power_off()


def interrupted(bench: Bench, hash_: str) -> str:
    """Flashes; returns ``dead``, the name of a diagnostic, or ``done``."""
    try:
        bench.apply(hash_)
    except Dead:
        return "dead"
    except DiagnosticError as error:
        return error.diagnostic.code.name
    return "done"


def code_of(work: Callable[[], object]) -> str:
    """Returns the name of the diagnostic that ``work`` raises; empty: none."""
    try:
        work()
    except DiagnosticError as error:
        return error.diagnostic.code.name
    return ""


def finish(bench: Bench) -> None:
    """Switches the power on and resumes; afterwards the bus is as after an undisturbed flash."""
    bench.simulated.power_on()
    bench.simulated.run(0.15)
    journal = Journal(bench.storage)
    if journal.unfinished:
        bench.resume()
    # If a node had an id that it had not stored, the reset reveals it; nothing is written.
    elif not journal.runs and code_of(bench.apply) == "plan-changed":
        bench.apply()


def check(bench: Bench, where: object, library: bool = False) -> None:
    assert bench.state() == undisturbed(library)[3], where
    assert not bench.watch.doubles, where
    live = {name: device.node_id for name, device in bench.devices().items() if name in NODES}
    assert live == dict(zip(NODES, (1, 2, 3, 4), strict=True)), where
    assert Journal(bench.storage).unfinished is None, where


@pytest.mark.parametrize("chunk", chunks())
def test_power_cut_at_every_frame(chunk: int) -> None:
    hash_, first, last, *_ = undisturbed()
    assert last - first > 500
    for number in range(first + chunk, last + 1, CHUNKS):
        bench = new()
        bench.wire.at_frame(number, functools.partial(cut_power, bench))
        assert interrupted(bench, hash_) == "dead", number
        bench.simulated.run(0.02)
        finish(bench)
        check(bench, number)


@pytest.mark.parametrize("torn", mostly_slow([False, True]), ids=["whole", "torn"])
def test_power_cut_in_the_middle_of_every_write(torn: bool) -> None:
    """The bus is idle during a write to memory; a torn write destroys the old value."""
    hash_, *_ = undisturbed()
    writes: list[int] = []
    bench = new()
    bench.wire.observers.append(
        lambda time, frame, _: writes.append(bench.wire.frames) if is_write(frame) else None
    )
    bench.apply(hash_)
    assert len(writes) == 5 + 4, "five moves, four times parameters"
    for number in writes:
        for delay in (0.005, 0.0199, 0.0203):
            bench = new(torn=torn)
            cut = functools.partial(cut_power, bench)
            timeline = bench.simulated.timeline
            bench.wire.at_frame(
                number,
                functools.partial(timeline.after, round(delay * 1e9), cut),  # type: ignore[arg-type]
            )
            assert interrupted(bench, hash_) == "dead"
            finish(bench)
            check(bench, (number, delay))


@pytest.mark.parametrize("how", ["resume", "rollback"])
def test_an_id_that_is_stored_but_not_active(how: str) -> None:
    """The master dies after a node has stored its next id: the stored id counts.

    The one at 1 has 2 stored.  To put the other one back to 2 without a reset would go well
    until the power is next switched off.
    """
    hash_, *_ = undisturbed()
    stores: list[int] = []
    bench = new()

    def watch(time: int, frame: CanFrame, senders: object) -> None:
        if frame.id == 0x7E4 and frame.data[0] == 0x17:
            stores.append(time)
            bench.interface.dead = len(stores) == 4

    bench.wire.observers.append(watch)
    assert interrupted(bench, hash_) == "dead"
    fr = bench.devices()["fr_controller"]
    assert (fr.node_id, fr.nonvolatile["node_id"]) == (1, 2)
    if how == "resume":
        finish(bench)
        check(bench, how)
    else:
        bench.rollback()
        assert [bench.state()[n][0] for n in NODES] == [2, 1, 255, 255]
    bench.simulated.power_off()
    bench.simulated.power_on()
    bench.simulated.run(0.2)
    assert not bench.watch.doubles


def is_write(frame: CanFrame) -> bool:
    lss = frame.id == 0x7E5 and frame.data[0] == 0x17
    return lss or (0x600 < frame.id < 0x680 and frame.data[1:4] == bytes([0x10, 0x10, 1]))


@pytest.mark.parametrize("start", mostly_slow([0, 23, 46]))
@pytest.mark.parametrize("cut", [cut_bus, kill_master], ids=["bus", "master"])
def test_the_bus_alone_or_the_master_alone(cut: Callable[[Bench], None], start: int) -> None:
    """The other side goes on: the master stops with a message, or the nodes keep their state."""
    hash_, first, last, *_ = undisturbed()
    for number in range(first + start, last, 69):
        bench = new()
        bench.wire.at_frame(number, functools.partial(cut, bench))
        how = interrupted(bench, hash_)
        if cut is kill_master:
            assert how == "dead"
        else:
            expected = ("bus-error", "flash-stopped", "plan-impossible", "plan-changed")
            assert how in expected, number
        finish(bench)
        check(bench, number)


@pytest.mark.parametrize("node", mostly_slow(NODES))
def test_one_node_loses_its_power(node: str) -> None:
    hash_, first, last, *_ = undisturbed()
    for number in range(first, last, 41):
        bench = new()
        device = bench.devices()[node]
        bench.wire.at_frame(number, device.power_off)
        how = interrupted(bench, hash_)
        assert how in ("flash-stopped", "plan-impossible", "plan-changed", "done"), number
        finish(bench)
        check(bench, number)


@pytest.mark.slow
def test_the_journal_is_cut_at_any_byte() -> None:
    """The rest of the journal is read, and the resume reaches the plan."""
    hash_, first, last, _, data = undisturbed()
    for length in range(0, len(data), 23):
        Journal(MemoryStorage(data[:length]))
    ends = [i for i, byte in enumerate(data) if byte == 0x0A]
    bench = new()
    bench.wire.at_frame((first + last) // 2, functools.partial(kill_master, bench))
    assert interrupted(bench, hash_) == "dead"
    written = bench.storage.data
    ends = [i for i, byte in enumerate(written) if byte == 0x0A]
    assert len(ends) > 5
    for end in ends:
        for length in (end - 9, end + 1):
            bench = new()
            bench.wire.at_frame((first + last) // 2, functools.partial(kill_master, bench))
            interrupted(bench, hash_)
            bench.storage.data = written[:length]
            finish(bench)
            check(bench, length)


def test_repeated_power_cuts() -> None:
    """Each resume is cut too, later each time, until one reaches its end."""
    hash_, first, *_ = undisturbed()
    bench = new()
    bench.wire.at_frame(first + 150, functools.partial(cut_power, bench))
    assert interrupted(bench, hash_) == "dead"
    for more in range(250, 2000, 57):
        bench.simulated.power_on()
        bench.simulated.run(0.15)
        bench.wire.at_frame(bench.wire.frames + more, lambda: cut_power(bench))
        try:
            bench.resume() if Journal(bench.storage).runs else bench.apply()
        except Dead:
            assert not bench.watch.doubles
            continue
        break
    check(bench, "after all")
    assert len(Journal(bench.storage).runs) > 3


@pytest.mark.parametrize("start", mostly_slow([350, 549]))
def test_the_drives_of_the_library(start: int) -> None:
    """All 72 values of each drive; a cut at every 398th frame."""
    hash_, first, last, *_ = undisturbed(True)
    assert last - first > 2000
    for number in range(first + start, last, 398):
        bench = new(cia402_robot())
        bench.wire.at_frame(number, functools.partial(cut_power, bench))
        assert interrupted(bench, hash_) == "dead"
        finish(bench)
        check(bench, number, library=True)
