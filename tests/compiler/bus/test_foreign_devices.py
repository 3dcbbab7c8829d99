"""Foreign devices: frames that pass, and none that could be the robot's own."""

from __future__ import annotations

import pytest

from tests.devices import BATTERY, Bench, line
from thorvaldc.compiler.bus.device_sections import BusSpec

SPRAYER = """
sprayer:
  id: 5
  canopen: [heartbeat]
  frames:
    command: {cob_id: 0x205, direction: command, rate: 10 Hz, description: Nozzles.}
    state: {cob_id: 0x185, direction: report, rate: 20 Hz, length: 4}
"""


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_allow_list_and_limits(bench: Bench) -> None:
    bench.drive(1)
    (bus,) = bench.build(foreign=SPRAYER)
    assert not list(bench.report)
    node = bus.nodes[-1]
    assert (node.name, node.id, node.id_space) == ("sprayer", 5, "canopen")
    assert (node.protocol, node.objects, node.automatic) == ("foreign", (), False)
    relayed = {f.name: f for f in bus.frames if f.kind == "relay"}
    command, state = relayed["sprayer_command"], relayed["sprayer_state"]
    assert (command.producer, command.consumers) == ("master", ("sprayer",))
    assert (command.cob_id, command.length, command.period) == (0x205, 8, None)
    assert command.minimum_interval == pytest.approx(0.1)
    assert (state.producer, state.consumers, state.length) == ("sprayer", ("master",), 4)
    assert state.minimum_interval == pytest.approx(0.05)
    assert any(f.cob_id == 0x705 for f in bus.frames)
    assert command.response_time is not None


def test_a_robot_may_have_nothing_else_on_a_bus(bench: Bench) -> None:
    buses = bench.build(
        (BusSpec("main", 500_000, line(98)), BusSpec("tools", 250_000, line(99))),
        foreign=SPRAYER.replace("id: 5", "id: 5\n  bus: tools"),
    )
    assert [[n.name for n in bus.nodes] for bus in buses] == [[], ["sprayer"]]


def test_without_an_id_it_has_none(bench: Bench) -> None:
    text = "\na: {frames: {x: {cob_id: 0x190, direction: report, rate: 1}}}\n"
    (bus,) = bench.build(foreign=text + text[1:].replace("a:", "b:").replace("0x190", "0x191"))
    assert not list(bench.report)
    assert [(n.id, n.id_space) for n in bus.nodes] == [(0, ""), (0, "")]
    assert [f.kind for f in bus.frames] == ["relay", "relay"]  # no CANopen, so no SYNC


@pytest.mark.parametrize(
    ("cob_id", "code"),
    [
        (0x000, "can-cob-id-restricted can-cob-id-conflict"),  # NMT: it would stop the drives
        (0x080, "can-cob-id-conflict"),  # SYNC
        (0x101, "can-cob-id-restricted"),
        (0x201, "can-cob-id-conflict"),  # RPDO1 of the drive
        (0x3C1, "can-cob-id-conflict"),  # the battery
        (0x601, "can-cob-id-restricted can-cob-id-conflict"),  # SDO of the drive
        (0x77F, "can-cob-id-restricted can-cob-id-conflict"),  # the master's heartbeat
        (0x205, ""),
    ],
)
def test_a_relayed_identifier_is_none_of_the_robots(bench: Bench, cob_id: int, code: str) -> None:
    bench.drive(1)
    bench.add(BATTERY, 1)
    text = f"\nsprayer: {{frames: {{x: {{cob_id: {cob_id}, direction: command, rate: 1}}}}}}\n"
    bench.build(foreign=text)
    assert " ".join(d.code.name for d in bench.report) == code
    for diagnostic in bench.report:
        places = [diagnostic.span, *(label.span for label in diagnostic.labels)]
        assert any(place is not None and place.line == 2 for place in places)  # the sprayer


def test_its_id_is_taken(bench: Bench) -> None:
    bench.drive(None)
    bench.drive(None)
    (bus,) = bench.build(foreign=SPRAYER.replace("id: 5", "id: 1").replace("0x185", "0x190"))
    assert [n.id for n in bus.nodes] == [2, 3, 1]
    bench = Bench()
    bench.drive(5)
    bench.build(foreign=SPRAYER.replace("0x185", "0x190").replace("0x205", "0x191"))
    diagnostic = bench.only_diagnostic("can-id-duplicate")
    assert (diagnostic.span, diagnostic.labels[0].span) != (None, None)


def test_a_crowded_relay_is_a_load(bench: Bench) -> None:
    bench.drive(1)
    bench.build(foreign=SPRAYER.replace("10 Hz", "2000 Hz"))
    assert "can-load" in [d.code.name for d in bench.report]
