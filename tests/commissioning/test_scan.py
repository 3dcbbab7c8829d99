"""Verdicts of scans."""

from __future__ import annotations

import struct
from dataclasses import replace

import pytest

from tests.commissioning.bench import NODES, QUICK, SWAPPED, Bench, four_drives
from tests.commissioning.robots import without_serials
from tests.examples import example_robot
from tests.simulation.bus.robots import cia402_robot, uneven_robot
from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.planner import make_plan
from thorvaldc.commissioning.scan_result import ScanResult
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.diagnostics import DiagnosticError


def passive(bench: Bench) -> ScanResult:
    master = bench.master()
    try:
        return Scanner(master, bench.configuration).passive()
    finally:
        master.interface.close()


def verdicts(scan: ScanResult) -> dict[str, str]:
    return {
        entry.node or str(entry.device and entry.device.id): entry.verdict for entry in scan.entries
    }


def test_a_robot_that_matches_its_file_is_ok() -> None:
    for robot in (cia402_robot(), uneven_robot(), example_robot("4wd4ws_wide")):
        bench = Bench(robot, delivered=False)
        for scan in (passive(bench), bench.scan()):
            assert set(verdicts(scan).values()) == {"ok"}
            assert not scan.duplicates
            assert not scan.masters
            assert not scan.enabled
        assert make_plan(bench.configuration, bench.scan()).steps == ()


def test_a_passive_scan_sends_nothing() -> None:
    bench = Bench(cia402_robot(), delivered=False)
    passive(bench)
    assert bench.interface.controller.sent == 0


def requests_of(bench: Bench) -> list[tuple[int, int, int]]:
    """Returns a list that receives node, index and subindex of each SDO upload request."""
    requests: list[tuple[int, int, int]] = []

    def watch(time: int, frame: CanFrame, senders: object) -> None:
        if 0x600 < frame.id <= 0x6FF and frame.data[0] == 0x40:
            requests.append((frame.id - 0x600, *struct.unpack_from("<HB", frame.data, 1)))

    bench.wire.observers.append(watch)
    return requests


def test_requests_of_a_scan() -> None:
    """The serial number is read twice, since two nodes with one id have different ones."""
    bench = Bench(four_drives(), delivered=False, timing=QUICK)
    requests = requests_of(bench)
    scan = bench.scan(values=False)
    assert [r[0] for r in requests[:126]] == list(range(1, 127))
    identity = [(0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4), (0x1018, 4)]
    texts = [(0x1008, 0), (0x1009, 0), (0x100A, 0)]
    expected = [(node, *key) for node in (1, 2, 3, 4) for key in identity + texts]
    assert [r for r in requests[126:] if r[1] < 0x2000] == expected
    for name in NODES:
        device = scan.entry(name).device
        assert device is not None
        assert device.texts == (bench.devices()[name].device_name, "1.0", "1.0")


def test_values_are_read_from_nodes_that_have_them() -> None:
    """A rollback may want a node without an id; such a node has no SDO server."""
    bench = Bench(four_drives(), delivered=False, timing=QUICK)
    nodes = bench.configuration.nodes
    nodes = (nodes[0], replace(nodes[1], sdo=False), replace(nodes[2], id=255), *nodes[3:])
    bench.devices()[nodes[2].name].power_off()
    bench.configuration = replace(bench.configuration, nodes=nodes)
    requests = requests_of(bench)
    scan = bench.scan()
    assert set(scan.values) == {nodes[0].name, nodes[3].name}
    assert scan.values[nodes[0].name] == {value.key: value.value for value in nodes[0].values}
    assert max(node for node, _, _ in requests) == 126


def test_new_and_exchanged_nodes() -> None:
    scan = Bench(four_drives(), SWAPPED, timing=QUICK).scan()
    assert verdicts(scan) == {
        "fl_controller": "wrong-identity",
        "fr_controller": "wrong-identity",
        "rl_controller": "unconfigured",
        "rr_controller": "unconfigured",
    }
    assert scan.ids() == dict(zip(NODES, (2, 1, 255, 255), strict=True))
    assert "serial 0x102" in scan.entry("fl_controller").detail


@pytest.mark.parametrize("robot", ["cia402", "roboteq"])
def test_a_duplicate_is_suspected_by_listening_and_by_requests(robot: str) -> None:
    """One robot has serial numbers, the other nothing that distinguishes two controllers."""
    robot_model = four_drives() if robot == "cia402" else example_robot("4wd4ws_wide")
    bench = Bench(robot_model, delivered=False)
    bench.simulated.clone("fl_controller", "spare").power_on()
    bench.simulated.run(0.3)
    for scan in (passive(bench), bench.scan()):
        assert scan.entry("fl_controller").verdict == "duplicate-suspected"
        assert scan.entry("fr_controller").verdict == "ok"
        assert len(scan.duplicates) == 1


def test_two_devices_of_one_identity() -> None:
    bench = Bench(four_drives(), delivered=False, timing=QUICK)
    spare = bench.simulated.clone("fl_controller", "spare")
    spare.specification = bench.devices()["fl_controller"].specification
    spare.power_on()
    bench.simulated.run(0.3)
    scan = bench.scan()
    assert scan.entry("fl_controller").verdict == "duplicate-suspected"
    assert "2 devices" in scan.duplicates[0][1]


def test_a_node_without_power_and_one_too_many() -> None:
    bench = Bench(cia402_robot(), delivered=False)
    bench.simulated.devices["rl_controller"].power_off()
    bench.simulated.devices["battery"].power_off()
    bench.simulated.clone("rr_controller", "spare", node_id=77).power_on()
    bench.simulated.run(0.3)
    scan = bench.scan()
    assert verdicts(scan) == {
        "fl_controller": "ok",
        "fr_controller": "ok",
        "rl_controller": "missing",
        "rr_controller": "ok",
        "board": "ok",
        "battery": "missing",
        "sprayer": "ok",
        "77": "unexpected",
    }


def test_every_device_too_many_is_in_the_plan() -> None:
    bench = Bench(cia402_robot(), delivered=False)
    for node_id in (77, 78):
        bench.simulated.clone("rr_controller", f"spare_{node_id}", node_id=node_id).power_on()
    bench.simulated.run(0.3)
    strangers = make_plan(bench.configuration, bench.scan()).strangers
    assert len(strangers) == 2
    assert all(any(str(node_id) in text for text in strangers) for node_id in (77, 78))


def test_a_device_without_id_is_found_by_fastscan() -> None:
    """Without serial numbers in the file, a single remaining device is the node."""
    robot = without_serials(four_drives(), ["rr_controller"])
    bench = Bench(robot, SWAPPED, timing=QUICK)
    plan = bench.plan()
    step = next(s for s in plan.steps if s.node == "rr_controller")
    assert step.back_end == "lss-fastscan"
    bench.apply()
    assert [bench.state()[n][0] for n in NODES] == [1, 2, 3, 4]
    robot = without_serials(four_drives(), ["rl_controller", "rr_controller"])
    plan = Bench(robot, SWAPPED, timing=QUICK).plan()
    assert not plan.strangers
    assert sum("write its serial number into the file" in p for p in plan.problems) == 2


def test_another_master_is_not_disturbed() -> None:
    bench = Bench(four_drives(), delivered=False, timing=QUICK)
    driver = bench.simulated.interface(name="driver")
    driver.send(CanFrame(0x601, struct.pack("<BHB4x", 0x40, 0x1000, 0)))
    bench.simulated.timeline.after(100_000_000, lambda: driver.send(CanFrame(0x77F, b"\5")))
    with pytest.raises(DiagnosticError, match="master_heartbeat"):
        bench.scan()
    assert bench.interface.controller.sent == 0


def test_no_bitrate_is_tried() -> None:
    """On a bus with another bitrate the first request causes only error frames."""
    bench = Bench(four_drives(), delivered=False, timing=QUICK)
    for device in bench.devices().values():
        device.change_bitrate(250_000)
    with pytest.raises(DiagnosticError, match="error-passive") as raised:
        bench.scan()
    assert raised.value.diagnostic.code.name == "bus-error"
