"""Scan, flash, verify and drive with devices that behave like other protocol stacks."""

from __future__ import annotations

import pytest

from tests.commissioning.bench import NODES, QUICK, SWAPPED, Bench, four_drives
from tests.commissioning.robots import without_serials
from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.simulation.bus.robots import cia402_robot
from tests.slow import mostly_exhaustive, mostly_slow
from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.verify import verify
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model.scenario import Quirk
from thorvaldc.runtime.can_base.base_state_machine import BaseState

CANOPENNODE = (
    Quirk.LSS_RESPONDS_WHEN_SELECTED,
    Quirk.LENGTH_ABORTS,
    Quirk.ERROR_HISTORY_ABORTS,
    Quirk.ONE_CONSUMER_PER_NODE,
    Quirk.FIXED_COB_IDS,
    Quirk.BLOCK_TRANSFERS,
)
ALL = (*CANOPENNODE, Quirk.SEGMENTED_TRANSFERS, Quirk.INHIBIT_TIMES)
QUIRKS = [*((quirk,) for quirk in Quirk), CANOPENNODE, ALL]
each_quirk = pytest.mark.parametrize("quirks", QUIRKS, ids=lambda quirks: "+".join(quirks)[:40])
FACTORY = {name: {"node_id": 255} for name in NODES}


def fastscan_requests(bench: Bench) -> list[CanFrame]:
    """Returns a list that collects the fastscan requests on the bus from now on."""
    seen: list[CanFrame] = []
    bench.wire.observers.append(
        lambda time, frame, _: (
            seen.append(frame) if frame.id == 0x7E5 and frame.data[0] == 0x51 else None
        )
    )
    return seen


@each_quirk
def test_scan_of_new_devices(quirks: tuple[Quirk, ...]) -> None:
    bench = Bench(four_drives(), FACTORY, timing=QUICK, quirks=quirks)
    requests = fastscan_requests(bench)
    scan = bench.scan()
    assert scan.ids() == dict.fromkeys(NODES, 255)
    assert len(scan.entries) == len(NODES), "no unknown device"
    assert len(requests) == 1, "all serial numbers were found, so no identity is searched"


@each_quirk
@pytest.mark.parametrize("unknown", [1, 2, 4])
def test_scan_finds_every_device_without_id(quirks: tuple[Quirk, ...], unknown: int) -> None:
    robot = without_serials(four_drives(), NODES[:unknown])
    bench = Bench(robot, FACTORY, timing=QUICK, quirks=quirks)
    requests = fastscan_requests(bench)
    found = [entry.device for entry in bench.scan().entries if entry.device is not None]
    serials = {device.name: device.serial for device in bench.devices().values()}
    assert sorted(device.identity.serial for device in found if device.identity) == sorted(
        serials[name] for name in NODES
    )
    assert len(requests) <= 2 * 128 * unknown


@each_quirk
@pytest.mark.parametrize("unknown", mostly_slow([(), ("rr_controller",)]))
def test_flash_verify_and_rollback(quirks: tuple[Quirk, ...], unknown: tuple[str, ...]) -> None:
    robot = without_serials(four_drives(), unknown)
    bench = Bench(robot, SWAPPED, timing=QUICK, quirks=quirks)
    before = bench.state()
    bench.apply()
    assert [bench.state()[name][0] for name in NODES] == [1, 2, 3, 4]
    assert not bench.watch.doubles
    master = bench.master()
    try:
        assert verify(master, bench.configuration, bench.bus).passed
    finally:
        master.interface.close()
    bench.rollback()
    assert {name: bench.state()[name][0] for name in NODES} == {n: before[n][0] for n in NODES}


@pytest.mark.slow
@pytest.mark.parametrize(
    "quirks", mostly_exhaustive([ALL, (Quirk.NO_INHIBIT_TIMES,)]), ids=["all", "no_inhibit"]
)
def test_flash_of_all_values_and_drive(quirks: tuple[Quirk, ...]) -> None:
    """The devices keep the values that the flash stored, and then drive."""
    robot = cia402_robot()
    bench = Bench(robot, FACTORY, timing=QUICK, quirks=quirks)
    bench.apply()
    rig = Rig(robot, quirks=quirks)
    for name, device in bench.devices().items():
        rig.simulated.devices[name].nonvolatile.update(device.nonvolatile)
    rig.drive(FORWARD, 8.0)  # the watchdogs are read again and again
    assert rig.state is BaseState.ACTIVE
    assert rig.reason == ""


def test_a_device_that_responds_to_every_fastscan_request() -> None:
    """The scan ends with an unknown device, and a flash writes nothing."""
    bench = Bench(without_serials(four_drives(), NODES), FACTORY, timing=QUICK)
    controller = bench.simulated.interface(name="broken")

    def respond(time: int, frame: CanFrame, senders: object) -> None:
        if frame.id == 0x7E5 and frame.data[0] == 0x51:
            controller.send(CanFrame(0x7E4, b"\x4f" + bytes(7)))

    bench.wire.observers.append(respond)
    entry = bench.scan().entries[-1]
    assert (entry.node, entry.verdict) == ("", "unexpected")
    assert entry.detail == "the device with no id does not report its identity"
    with pytest.raises(DiagnosticError) as raised:
        bench.apply()
    assert raised.value.diagnostic.code.name == "plan-impossible"
    assert {state[0] for state in bench.state().values()} == {255}
