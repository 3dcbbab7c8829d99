"""A robot whose two CAN adapters are exchanged does not start, and says why."""

from __future__ import annotations

from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import load
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

ROBOT = """
thorvaldc: 1
name: two_sided
buses: {left: {bitrate: 500 kbit/s}, right: {bitrate: 500 kbit/s}}
defaults: {drive: {controller: controller/cia402_propulsion}}
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/fixed_drive, mount: frame.front_left, can: {bus: left%s}}
  rl: {type: assembly/fixed_drive, mount: frame.rear_left, can: {bus: left%s}}
  fr: {type: assembly/fixed_drive, mount: frame.front_right, can: {bus: right%s}}
  rr: {type: assembly/fixed_drive, mount: frame.rear_right, can: {bus: right%s}}
"""
AUTOMATIC = ("",) * 4
SERIALS = (
    ', id: 1, serial: "0x11"',
    ', id: 2, serial: "0x12"',
    ', id: 1, serial: "0x21"',
    ', id: 2, serial: "0x22"',
)


def start(
    folder: Path, addresses: tuple[str, ...], wires: dict[str, str], missing: str = ""
) -> CanBase:
    """Starts the robot with the wire ``wires[bus]`` at the interface of each bus."""
    file = folder / "robot.yaml"
    file.write_text(ROBOT % addresses, encoding="utf-8")
    robot = load(file)
    simulated = SimulatedRobot(robot, seed=1)
    simulated.power_on()
    if missing:
        simulated.devices[missing].power_off()
    interfaces = {bus: simulated.interface(wire, fifo=True) for bus, wire in wires.items()}
    base = CanBase(robot, interfaces, threaded=False)
    first = interfaces["left"]
    driven = DrivenRobot(robot, base, first)
    ends = (BaseState.READY, BaseState.FAULT)
    driven.run(first.now + 20.0, stop=lambda: base.state in ends)
    return base


@pytest.mark.parametrize("addresses", [AUTOMATIC, SERIALS], ids=["ids", "serials"])
def test_exchanged_buses_are_named(tmp_path: Path, addresses: tuple[str, ...]) -> None:
    base = start(tmp_path, addresses, {"left": "right", "right": "left"})
    assert base.state is BaseState.FAULT
    assert base.state_machine.reason == "the buses `left` and `right` are exchanged"
    assert base.state_machine.mismatch


def test_both_interfaces_at_one_bus_are_named(tmp_path: Path) -> None:
    base = start(tmp_path, AUTOMATIC, {"left": "right", "right": "right"})
    assert base.state is BaseState.FAULT
    expected = "the devices of the bus `right` are on the bus `left`"
    assert expected in base.state_machine.reason


@pytest.mark.parametrize("addresses", [AUTOMATIC, SERIALS], ids=["ids", "serials"])
def test_another_fault_of_the_start_is_no_exchange(
    tmp_path: Path, addresses: tuple[str, ...]
) -> None:
    wires = {"left": "left", "right": "right"}
    assert start(tmp_path, addresses, wires).state is BaseState.READY
    base = start(tmp_path, addresses, wires, missing="rr_controller")
    assert base.state is BaseState.FAULT
    assert "no heartbeat of rr_controller" in base.state_machine.reason
