"""Node ids, COB-IDs and names of a bus: each conflict is reported with both devices."""

from __future__ import annotations

import pytest

from tests.devices import (
    BATTERY,
    CIA_402,
    DRIVE,
    MOTORS,
    SIMPLE,
    Bench,
    line,
    simple,
)
from thorvaldc.compiler.bus.device_sections import BusSpec


@pytest.fixture
def bench() -> Bench:
    return Bench()


# -- ids ------------------------------------------------------------------------------


def test_automatic_ids_are_the_lowest_free_and_never_take_an_explicit_one(bench: Bench) -> None:
    for address in (None, 2, "auto", 1, {"serial": "0x12"}):
        bench.add(DRIVE, address)
    bench.add("io/board")
    bench.add(BATTERY)
    (bus,) = bench.build(motors=())
    assert [n.id for n in bus.nodes] == [3, 2, 4, 1, 5, 32, 1]
    assert bus.nodes[4].serial == "0x12"


def test_id_out_of_range(bench: Bench) -> None:
    bench.drive(128)
    bench.build()
    diagnostic = bench.only_diagnostic("can-id-range")
    assert diagnostic.span == line(1)
    assert "128" in diagnostic.message
    assert "1 to 127" in diagnostic.message


def test_id_twice_names_both_places(bench: Bench) -> None:
    bench.drive(4)
    bench.drive(5)
    bench.drive(4)
    bench.build()
    diagnostic = bench.only_diagnostic("can-id-duplicate")
    assert diagnostic.span == line(3)
    assert [label.span for label in diagnostic.labels] == [line(1)]


def test_id_spaces_and_buses_are_apart(bench: Bench) -> None:
    bench.drive(4)
    bench.drive({"bus": "second", "id": 4})
    bench.add(BATTERY, 4)
    buses = bench.build((BusSpec("main", 500_000, line(98)), BusSpec("second", 250_000, line(99))))
    assert [d.code.name for d in bench.report] == ["can-buses-alike"]
    assert [[(n.name, n.id) for n in bus.nodes] for bus in buses] == [
        [("d1", 4), ("d3", 4)],
        [("d2", 4)],
    ]


def test_no_id_left(bench: Bench) -> None:
    for _ in range(32):
        bench.add(DRIVE)
    bench.build(motors=())
    faults = [d for d in bench.report if d.code.name == "can-ids-exhausted"]
    assert [f.span for f in faults] == [line(32)]


def test_unknown_bus(bench: Bench) -> None:
    bench.drive({"bus": "mian"})
    bench.build()
    assert bench.only_diagnostic("can-bus-unknown").hint == "did you mean `main`?"


def test_serial_number_twice(bench: Bench) -> None:
    for serial in ("0x12", "0x13", "0x12"):
        bench.add(CIA_402, {"serial": serial})
    bench.build(motors=())
    (duplicate,) = [d for d in bench.report if d.code.name == "can-serial-duplicate"]
    assert [label.span for label in duplicate.labels] == [line(1)]


def test_address_of_an_empty_enclosure(bench: Bench) -> None:
    bench.add(BATTERY, 1, params={"with_battery": False})
    assert bench.build() == ()
    assert bench.only_diagnostic("can-address-unused").span == line(1)


# -- COB-IDs --------------------------------------------------------------------------


@pytest.mark.parametrize(("offset", "named"), [(64, "0x3c5"), (80, "0x3d5"), (96, "0x3e5")])
def test_battery_against_a_drives_tpdo3(bench: Bench, offset: int, named: str) -> None:
    bench.drive(offset + 5)
    bench.add(BATTERY, 5)
    bench.build()
    diagnostic = bench.only_diagnostic("can-cob-id-conflict")
    assert diagnostic.span == line(2)
    assert [label.span for label in diagnostic.labels] == [line(1)]
    assert named in diagnostic.message
    assert "tpdo3" in diagnostic.message


def test_battery_beside_other_ids_does_not_conflict(bench: Bench) -> None:
    for node_id in (63, 68, 70, 111):
        bench.drive(node_id)
    bench.add(BATTERY, 5)
    bench.build()
    assert not bench.report.has_errors


def test_drive_with_the_masters_id(bench: Bench) -> None:
    bench.drive(127)
    bench.build()
    diagnostic = bench.only_diagnostic("can-cob-id-conflict")
    assert "0x77f" in diagnostic.message
    assert not diagnostic.labels  # the master is in no line of the file


@pytest.mark.parametrize(
    ("cob_id", "code"),
    [
        (0x000, "can-cob-id-restricted can-cob-id-conflict"),  # NMT
        (0x07F, "can-cob-id-restricted"),
        (0x080, "can-cob-id-conflict"),  # SYNC
        (0x085, "can-cob-id-conflict"),  # EMCY of node 5
        (0x0FF, ""),
        (0x100, "can-cob-id-conflict"),  # TIME
        (0x101, "can-cob-id-restricted"),
        (0x180, "can-cob-id-restricted"),
        (0x185, "can-cob-id-conflict"),  # TPDO1 of node 5
        (0x205, "can-cob-id-conflict"),  # RPDO1 of node 5, which the master sends
        (0x580, ""),
        (0x581, "can-cob-id-restricted"),
        (0x585, "can-cob-id-restricted can-cob-id-conflict"),
        (0x6DF, ""),
        (0x6E0, "can-cob-id-restricted"),
        (0x700, ""),
        (0x705, "can-cob-id-restricted can-cob-id-conflict"),
        (0x7E4, "can-cob-id-restricted can-cob-id-conflict"),  # LSS
        (0x7E5, "can-cob-id-restricted can-cob-id-conflict"),
        (0x7FF, "can-cob-id-restricted"),
        (0x800, "can-cob-id-range"),
    ],
)
@pytest.mark.parametrize("kind", ["pdo", "relay", "broadcast"])
def test_foreign_frame_over_the_full_expansion(
    bench: Bench, kind: str, cob_id: int, code: str
) -> None:
    bench.drive(5)
    bench.add("my/sprayer", 6, text=simple(cob_id=cob_id, kind=kind), wires={"motor": MOTORS[2]})
    bench.build()
    assert " ".join(d.code.name for d in bench.report) == code
    for diagnostic in bench.report:
        places = {label.span for label in diagnostic.labels} | {diagnostic.span}
        assert line(2) in places


@pytest.mark.parametrize("cob_id", [0x000, 0x001, 0x07F, 0x080, 0x101, 0x601, 0x705, 0x7E4, 0x7FF])
@pytest.mark.parametrize(
    ("kind", "allowed"), [("pdo", True), ("broadcast", True), ("relay", False)]
)
def test_identifiers_of_canopen_on_a_bus_without_canopen(
    bench: Bench, kind: str, allowed: bool, cob_id: int
) -> None:
    """Another protocol may use every identifier; a foreign device may still be a CANopen device."""
    text = simple(cob_id=cob_id, kind=kind).replace("id_space: canopen", "id_space: mine")
    bench.add("my/other", 6, text=text, wires={"motor": MOTORS[0]})
    (bus,) = bench.build()
    refused = not allowed and cob_id != 0x080
    assert [d.code.name for d in bench.report] == ["can-cob-id-restricted"] * refused
    assert [f.kind for f in bus.frames] == [kind], "no frame of a CANopen master"


def test_two_frames_of_one_device(bench: Bench) -> None:
    text = simple() + "    b: {cob_id: 0x190, kind: pdo, direction: report, length: 1}\n"
    bench.add("my/twice", 6, text=text, wires={"motor": MOTORS[0]})
    bench.build()
    assert "two frames of `d1`" in bench.only_diagnostic("can-cob-id-conflict").message


def test_names_must_differ(bench: Bench) -> None:
    text = SIMPLE + "    b_x: {cob_id: 0x190, kind: pdo, direction: report, length: 1}\n"
    other = SIMPLE + "    x: {cob_id: 0x191, kind: pdo, direction: report, length: 1}\n"
    bench.add("my/a", 6, text=text, wires={"motor": MOTORS[0]}, name="a")
    bench.add("my/b", 7, text=other, wires={"motor": MOTORS[2]}, name="a_b")
    bench.build()
    assert "a_b_x" in bench.only_diagnostic("can-name-conflict").message


def test_a_device_may_not_be_called_master(bench: Bench) -> None:
    bench.add("my/a", 6, text=simple(), wires={"motor": MOTORS[0]}, name="master")
    bench.build()
    assert "master" in bench.only_diagnostic("can-name-conflict").message
