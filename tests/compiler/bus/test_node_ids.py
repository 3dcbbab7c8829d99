"""Automatic ids stay what they were, whatever is added, taken away or given by hand."""

from __future__ import annotations

import dataclasses
import random

import pytest

from tests.devices import BATTERY, DRIVE, Bench, line
from tests.robots import FOUR_STEERED, make_robot
from tests.slow import mostly_slow
from thorvaldc.compiler.bus.device_sections import BusSpec
from thorvaldc.compiler.bus.node_ids import Lock, Pin, address_lines, chosen_ids, read_lock
from thorvaldc.compiler.source.lock_file import lock_text
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Bus, Robot

TWO_BUSES = (BusSpec("main", 500_000, line(98)), BusSpec("true", 250_000, line(99)))


def robot_of(buses: tuple[Bus, ...]) -> Robot:
    return dataclasses.replace(make_robot(FOUR_STEERED), buses=buses)


def read(text: str) -> Lock:
    report = Report()
    document = read_text(text.encode(), "robot.lock.yaml", report)
    assert document is not None
    lock = read_lock(document, report)
    assert not list(report), [d.message for d in report]
    return lock


def text_of(robot: Robot) -> str:
    return lock_text("robot.yaml", (), address_lines(chosen_ids(robot)))


def pinned(bench: Bench, specs: tuple[BusSpec, ...] = TWO_BUSES[:1]) -> Lock:
    return read(text_of(robot_of(bench.build(specs, motors=()))))


def ids(buses: tuple[Bus, ...]) -> dict[str, int]:
    return {node.module: node.id for bus in buses for node in bus.nodes}


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_device_before_the_others_takes_no_ones_id(bench: Bench) -> None:
    for name in ("a", "b"):
        bench.add(DRIVE, name=name)
    lock = pinned(bench)
    later = Bench()
    for name in ("first", "a", "b"):
        later.add(DRIVE, name=name)
    assert ids(later.build(motors=(), lock=lock)) == {"first": 3, "a": 1, "b": 2}
    assert not later.report.has_errors
    # without the lock it would
    assert ids(later.build(motors=())) == {"first": 1, "a": 2, "b": 3}


def test_what_is_in_a_lock_file_comes_out_of_it_again(bench: Bench) -> None:
    bench.add(DRIVE, name="true")
    bench.add(DRIVE, {"bus": "true"}, name="null")
    bench.add(BATTERY, name="battery")
    bench.add("io/board", 40, name="by_hand")
    lock = pinned(bench, TWO_BUSES)
    assert {key: pin.id for key, pin in lock.items()} == {
        ("main", "canopen", "true"): 1,
        ("true", "canopen", "null"): 2,
        ("main", "kc_battery", "battery"): 1,
    }


def test_chosen_ids_are_unique_on_all_buses_of_a_robot(bench: Bench) -> None:
    """So the start notices exchanged interfaces.  Without a free one, an id is used twice."""
    bench.add(DRIVE, {"bus": "true", "id": 2}, name="by_hand")
    bench.add(DRIVE, name="kept")
    for number in range(30):
        bench.add(DRIVE, {"bus": "true"} if number % 2 else None, name=f"m{number}")
    lock = {("main", "canopen", "kept"): Pin(2, Span("robot.lock.yaml"))}
    chosen = ids(bench.build(TWO_BUSES, motors=(), lock=lock))
    assert (chosen.pop("by_hand"), chosen.pop("kept")) == (2, 2)  # the devices have these ids
    assert sorted(chosen.values()) == [1, *range(3, 32)]
    bench.add(DRIVE, name="one_more")
    assert ids(bench.build(TWO_BUSES, motors=(), lock=lock))["one_more"] == 3
    assert "can-ids-exhausted" not in [d.code.name for d in bench.report]


def test_only_chosen_ids_need_a_lock_file(bench: Bench) -> None:
    bench.add("io/board", 40, name="by_hand")
    assert not chosen_ids(robot_of(bench.build(motors=())))
    assert text_of(robot_of(bench.build(motors=()))).endswith("addresses: {}\n")
    bench.add("io/board", name="chosen")
    assert chosen_ids(robot_of(bench.build(motors=())))


def test_an_id_of_a_module_that_is_gone_is_free(bench: Bench) -> None:
    bench.add(DRIVE, name="a")
    lock = pinned(bench)
    later = Bench()
    later.add(DRIVE, name="b")
    assert ids(later.build(motors=(), lock=lock)) == {"b": 1}
    assert pinned(later).keys() == {("main", "canopen", "b")}


def test_an_id_given_by_hand_counts_and_the_pin_is_said_to_be_unused(bench: Bench) -> None:
    bench.add(DRIVE, name="a")
    lock = pinned(bench)
    later = Bench()
    later.add(DRIVE, 7, name="a")
    later.add(DRIVE, name="b")
    assert ids(later.build(motors=(), lock=lock)) == {"a": 7, "b": 1}
    unused = next(d for d in later.report if d.code.name == "can-lock-unused")
    assert unused.span == line(1)
    assert unused.labels[0].span.file == "robot.lock.yaml"


def test_another_device_with_a_pinned_id_is_a_conflict_with_all_places(bench: Bench) -> None:
    bench.add(DRIVE, name="a")
    lock = pinned(bench)
    later = Bench()
    later.add(DRIVE, 1, name="b")
    later.add(DRIVE, name="a")
    later.build(motors=(), lock=lock)
    (diagnostic,) = later.report.errors
    assert diagnostic.code.name == "can-lock-conflict"
    assert diagnostic.span == line(1)
    assert [label.span.file for label in diagnostic.labels] == ["robot.lock.yaml", "robot.yaml"]
    assert diagnostic.labels[1].span == line(2)


def test_a_foreign_device_with_a_pinned_id_is_a_conflict(bench: Bench) -> None:
    bench.add(DRIVE, name="a")
    lock = pinned(bench)
    foreign = "\nsprayer: {id: 1, frames: {s: {cob_id: 0x190, direction: report, rate: 1}}}\n"
    bench.build(motors=(), lock=lock, foreign=foreign)
    (diagnostic,) = bench.report.errors
    assert diagnostic.code.name == "can-lock-conflict"
    assert "`sprayer`" in diagnostic.message


@pytest.mark.parametrize("seed", mostly_slow(range(30), 3, slow=3))
def test_no_history_of_changes_renumbers_a_device(seed: int) -> None:
    """Devices come and go in any order, by hand or chosen; who stays keeps the id."""
    generator = random.Random(seed)
    present: dict[str, int | None] = {}  # the id by hand, if any
    lock: Lock = {}
    before: dict[str, int] = {}
    for _ in range(12):
        name = f"m{generator.randrange(8)}"
        if name in present:
            del present[name]
        else:
            free = [i for i in range(1, 31) if i not in before.values()]
            present[name] = generator.choice(free) if generator.random() < 0.3 else None
        order = sorted(present, key=lambda _: generator.random())
        bench = Bench()
        for module in order:
            bench.add(DRIVE, present[module], name=module)
        buses = bench.build(motors=(), lock=lock)
        assert not bench.report.has_errors, [d.message for d in bench.report.errors]
        now = ids(buses)
        assert {m: now[m] for m in now if m in before} == {m: before[m] for m in before if m in now}
        assert len(set(now.values())) == len(now)
        lock, before = read(text_of(robot_of(buses))), now
