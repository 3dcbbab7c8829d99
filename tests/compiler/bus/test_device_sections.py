"""What a node's object dictionary must hold: identity, heartbeats, PDOs, and the module's own."""

from __future__ import annotations

import pytest

from tests.devices import CIA_402, MOTORS, Bench, line
from thorvaldc.model import Node, ObjectValue

WIRES = {"propulsion": MOTORS[0], "steering": MOTORS[1]}
TEXT = """
description: test
channels: {motor: {role: propulsion}}
can:
  protocol: mine
  vendor_id: 0x469
  canopen: [sdo, heartbeat, emcy]
"""


@pytest.fixture
def bench() -> Bench:
    return Bench()


def entries(node: Node) -> dict[tuple[int, int], ObjectValue]:
    found = {(e.index, e.subindex): e for e in node.objects}
    assert list(found) == sorted(found)
    assert len(found) == len(node.objects)
    return found


def only(bench: Bench) -> dict[tuple[int, int], ObjectValue]:
    (bus,) = bench.build(motors=[w.actuator for d in bench.devices for w in d.wires])
    (node,) = bus.nodes
    return entries(node)


def test_identity_and_heartbeat_follow_from_the_rest(bench: Bench) -> None:
    bench.add("my/a", {"id": 5, "serial": "0x12"}, {"motor": MOTORS[0]}, text=TEXT)
    found = only(bench)
    values = {key: entry.value for key, entry in found.items()}
    assert values == {
        (0x1000, 0): None,
        (0x1001, 0): None,
        (0x1014, 0): 0x085,
        (0x1017, 0): 100,
        (0x1018, 1): 0x469,
        (0x1018, 2): None,
        (0x1018, 3): None,
        (0x1018, 4): 0x12,
    }
    assert {key: e.access for key, e in found.items() if key[0] == 0x1018} == dict.fromkeys(
        [(0x1018, i) for i in (1, 2, 3, 4)], "ro"
    )


def test_a_node_that_cannot_be_asked_has_no_objects(bench: Bench) -> None:
    bench.add("io/board", 5)
    assert only(bench) == {}


def test_drive_watches_the_master(bench: Bench) -> None:
    bench.add(CIA_402, 5, WIRES, params={"heartbeat_consumer_time": 0.3})
    found = only(bench)
    assert found[0x1016, 1].value == 0x7F << 16 | 300
    assert not list(bench.report)


def test_pdo_mappings_are_the_published_ones_of_the_original(bench: Bench) -> None:
    bench.drive(5)
    found = only(bench)
    assert found[0x1400, 1].value == 0x205
    assert found[0x1600, 1].value == 0x2005_09_20
    assert found[0x1603, 2].value == 0x2005_10_20
    assert found[0x1A00, 1].value == 0x2106_01_20
    assert (found[0x1803, 2].value, found[0x1803, 5].value) == (255, 1000)


def test_objects_of_a_channel_without_a_motor_are_left_out(bench: Bench) -> None:
    bench.add(CIA_402, 5, {"propulsion": MOTORS[0]})
    found = only(bench)
    assert (0x6060, 0) in found
    assert (0x687D, 1) not in found
    assert not list(bench.report)


def test_limits_follow_from_motor_and_joint(bench: Bench) -> None:
    bench.add(CIA_402, 5, WIRES, limits=(-1.0, 2.0))
    found = only(bench)
    counts = 4 * MOTORS[1].encoder_ppr * MOTORS[1].gear_ratio / (2 * 3.141592653589793)
    assert found[0x687D, 1].value == round(-counts)
    assert found[0x687D, 2].value == round(2 * counts)
    assert found[0x687C, 0].value == round(counts)  # at the stop, the zero is so far away
    assert found[0x687F, 0].value == round(MOTORS[1].max_velocity * counts)
    assert (found[0x68C2, 1].value, found[0x68C2, 2].value) == (20, -3)


def own(objects: str) -> str:
    return f"{TEXT}  objects:\n    x: {{{objects}}}\n"


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("index: 0x2000, type: unsigned8, value: 255", 255),
        ("index: 0x2000, type: integer8, value: -128", -128),
        ("index: 0x2000, type: boolean, value: 1", 1),
        ("index: 0x2000, type: unsigned32, value: 4294967295", 4294967295),
        ("index: 0x2000, type: integer32, value: -2147483648", -2147483648),
        ("index: 0x2000, type: integer16, value: 1.6", 2),
        ('index: 0x2000, type: integer16, value: "${cycle / 1 ms + id}"', 25),
        ("index: 0x2000, type: unsigned8, value: 256", "can-object-range"),
        ("index: 0x2000, type: unsigned8, value: -1", "can-object-range"),
        ("index: 0x2000, type: boolean, value: 2", "can-object-range"),
        ("index: 0x2000, type: integer16, value: 32768", "can-object-range"),
        ("index: 0x2000, subindex: 255, type: unsigned8, value: 1", "can-object-range"),
        ("index: -1, type: unsigned8, value: 1", "can-object-range"),
        ("index: 0x1017, type: unsigned16, value: 1", "can-object-duplicate"),
        ("index: 0x2000, type: unsigned8, value: 1, channel: mtoor", "channel-unknown"),
        ('index: 0x2000, type: unsigned8, value: "${1 / 0}"', "expression-value"),
        ('index: "${0x2000 + 0.5}", type: unsigned8, value: 1', "wrong-type"),
    ],
)
def test_an_objects_value(bench: Bench, entry: str, value: int | str) -> None:
    bench.add("my/a", 5, {"motor": MOTORS[0]}, text=own(entry))
    found = only(bench)
    if isinstance(value, int):
        assert not list(bench.report)
        assert found[0x2000, 0].value == value
    else:
        assert [d.code.name for d in bench.report] == [value]


def test_a_wrong_object_of_a_module_used_twice_is_one_fault(bench: Bench) -> None:
    for motor in (MOTORS[0], MOTORS[2]):
        text = own("index: 0x20000, type: unsigned8, value: 1")
        bench.add("my/a", None, {"motor": motor}, text=text)
    bench.build()
    assert bench.only_diagnostic("can-object-range").span is not None


# -- heartbeats ---------------------------------------------------------------------------


def beats(more: str) -> str:
    return f"{TEXT}  {more}\n"


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ("heartbeat_timeout: 200 ms", ""),
        ("heartbeat_timeout: 199 ms", "can-heartbeat-time"),
        ("heartbeat_period: 50 ms", ""),  # three times that, without a word
        ("heartbeat_consumer_time: 200 ms", ""),
        ("heartbeat_consumer_time: 199 ms", "can-heartbeat-time"),
        ("heartbeat_consumer_time: 70 s", "can-object-range"),
        ("heartbeat_period: 0.4 ms", "can-object-range can-deadline"),
        ("device_type: 0x20192", "can-heartbeat-consumer"),
        ("device_type: 0x20191", ""),
    ],
)
def test_heartbeats(bench: Bench, more: str, code: str) -> None:
    bench.add("my/a", 5, {"motor": MOTORS[0]}, text=beats(more))
    only(bench)
    assert " ".join(d.code.name for d in bench.report) == code
    for diagnostic in bench.report:
        places = [diagnostic.span, *(label.span for label in diagnostic.labels)]
        if "heartbeat" in diagnostic.code.name:
            assert line(1) in places
            assert "my/a/module.yaml" in [place.file for place in places if place is not None]


def test_the_masters_patience_by_default(bench: Bench) -> None:
    bench.add("my/a", 5, {"motor": MOTORS[0]}, text=beats("heartbeat_period: 40 ms"))
    bench.add("io/board", 6)
    (bus,) = bench.build()
    assert [n.heartbeat_timeout for n in bus.nodes] == [pytest.approx(0.12), None]


def test_serial_numbers_are_one_in_any_form_and_on_any_bus(bench: Bench) -> None:
    bench.add(CIA_402, {"serial": "18"})
    bench.add(CIA_402, {"serial": "0x12"})
    bench.add(CIA_402, {"serial": "0x12"}, params={"vendor_id": 7})  # another vendor's
    bench.build(motors=())
    faults = [d for d in bench.report if d.code.name == "can-serial-duplicate"]
    assert [(f.span, f.labels[0].span) for f in faults] == [(line(2), line(1))]
