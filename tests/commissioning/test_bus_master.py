"""The master on a bus with errors, and which frames it takes as a sign of another master."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.commissioning.bench import four_drives
from thorvaldc.can.canopen import NmtCommand
from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.bus_master import BusMaster
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire


def bus() -> tuple[BusMaster, VirtualTimeInterface, VirtualTimeInterface]:
    wire = Wire(Timeline())
    interface = VirtualTimeInterface(wire, "master")
    other = VirtualTimeInterface(wire, "other")
    interface.sleep(0.001)
    # Frames of the robot file have their names there.
    return BusMaster(interface, replace(four_drives().buses[0], frames=())), interface, other


def test_nothing_is_sent_by_an_interface_with_errors() -> None:
    master, interface, _ = bus()
    interface.controller.transmit_errors = 200
    with pytest.raises(DiagnosticError, match="error-passive"):
        master.nmt(NmtCommand.START, 1)
    assert interface.controller.pending == 0


@pytest.mark.parametrize(
    ("frame", "sign"),
    [
        ("000#0101", "0x000"),
        ("080#", "0x080"),
        ("100#000000000000", "0x100"),
        ("7E5#0400000000000000", "0x7e5"),
        ("601#4000100000000000", "an SDO request to node 1"),
        ("67F#4000100000000000", "an SDO request to node 127"),
        ("77F#05", "a master's heartbeat"),
        ("600#00", ""),
        ("680#00", ""),
        ("701#05", ""),
        ("581#4300100000000000", ""),
        ("7E4#4F00000000000000", ""),
        ("00000080#00", ""),
        ("00000581#4300100000000000", ""),
    ],
)
def test_signs_of_another_master(frame: str, sign: str) -> None:
    master, _, other = bus()
    identifier, _, data = frame.partition("#")
    other.send(CanFrame(int(identifier, 16), bytes.fromhex(data), extended=len(identifier) == 8))
    master.listen(0.01)
    assert master.masters == ({sign: 1} if sign else {})
