"""Simulated devices keep who they are and what they drive, whatever the robot file says later."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import CIA402, at_home, cia402_robot, compiled
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_robot import (
    Memory,
    SimulatedRobot,
    read_memory,
    write_memory,
)

FL, FR = "fl_controller", "fr_controller"
EXCHANGED = CIA402.replace("0x101", "?").replace("0x102", "0x101").replace("?", "0x102")
"""The robot with the serial numbers of its front controllers exchanged."""


def stored(path: Path, simulated: SimulatedRobot, robot: Robot) -> Memory:
    """Returns what the next run of a simulated bus reads, here that of ``robot``."""
    write_memory(path, simulated)
    report = Report()
    memory = read_memory(path, robot, report)
    assert memory is not None, list(report)
    return memory


def serial(simulated: SimulatedRobot, name: str) -> int | None:
    device = simulated.devices[name]
    assert isinstance(device, CanopenDevice)
    return device.serial


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_the_memory_of_every_robot_reads_back(name: str, tmp_path: Path) -> None:
    robot = example_robot(name)
    simulated = SimulatedRobot(robot)
    memory = stored(tmp_path / "memory.json", simulated, robot)
    assert memory == simulated.memory()
    again = SimulatedRobot(robot, nonvolatile=memory)
    assert again.memory() == memory


def test_a_file_without_serial_numbers_gets_those_of_the_devices(tmp_path: Path) -> None:
    """As in the tutorial: the file names the serial numbers after the devices were delivered."""
    unknown = compiled(CIA402.replace(', serial: "0x101"', "").replace(', serial: "0x102"', ""))
    new = SimulatedRobot(unknown, delivered=True)
    numbers = [serial(new, name) for name in (FL, FR)]
    assert len({*numbers, None, 0x101, 0x102}) == 5
    memory = stored(tmp_path / "memory.json", new, unknown)
    for text in (CIA402, EXCHANGED):
        again = SimulatedRobot(compiled(text), nonvolatile=memory)
        assert [serial(again, name) for name in (FL, FR)] == numbers


def test_the_start_names_controllers_that_are_exchanged_in_the_file(tmp_path: Path) -> None:
    robot, exchanged = at_home(cia402_robot()), at_home(compiled(EXCHANGED))
    memory = stored(tmp_path / "memory.json", SimulatedRobot(robot), exchanged)
    rig = Rig(exchanged, memory=memory)
    rig.run(5.0)
    assert rig.state is BaseState.FAULT
    assert "fl_controller: serial_number (0x1018:4) is 257" in rig.reason
    rig = Rig(robot, memory=memory)
    rig.ready()


def test_a_drive_without_lss_reports_the_serial_number_of_the_file() -> None:
    robot = at_home(cia402_robot())
    nodes = [replace(node, lss=False) for node in robot.buses[0].nodes]
    robot = replace(robot, buses=(replace(robot.buses[0], nodes=tuple(nodes)),))
    rig = Rig(robot)
    rig.ready()
    device = rig.simulated.devices[FL]
    assert isinstance(device, CanopenDevice)
    assert device.lss is None


def test_controllers_that_are_wired_crosswise_turn_the_other_wheel() -> None:
    robot = example_robot("lss")
    memory = SimulatedRobot(robot).memory()
    left, right = memory["left_controller"], memory["right_controller"]
    assert left["motors"] == {"propulsion": "left_drive_propulsion"}
    usual = wheel_speeds(Rig(robot, memory=memory))
    assert usual["left_drive_propulsion"] < -0.5 < 0.5 < usual["right_drive_propulsion"]
    left["motors"], right["motors"] = right["motors"], left["motors"]
    crossed = wheel_speeds(Rig(robot, memory=memory))
    assert crossed["left_drive_propulsion"] == pytest.approx(usual["right_drive_propulsion"])
    assert crossed["right_drive_propulsion"] == pytest.approx(usual["left_drive_propulsion"])


def wheel_speeds(rig: Rig) -> dict[str, float]:
    """Returns the true speeds (rad/s) of the wheels of a robot that shall turn to the left."""
    rig.ready()
    rig.arm()
    rig.twist = Twist(0.0, 0.0, 0.5)
    rig.run(2.0)
    return {name: motor.read(rig.now).velocity for name, motor in rig.simulated.motors.items()}


def test_a_battery_and_a_board_keep_their_ids(tmp_path: Path) -> None:
    memory = stored(tmp_path / "memory.json", SimulatedRobot(cia402_robot()), cia402_robot())
    text = CIA402.replace("can: 32}", "can: 33}").replace("0.07]}, can: 1}", "0.07]}, can: 2}")
    simulated = SimulatedRobot(compiled(text), nonvolatile=memory)
    assert simulated.devices["board"].id == 32  # type: ignore[attr-defined]
    assert simulated.devices["battery"].id == 1  # type: ignore[attr-defined]


def test_a_device_that_the_file_does_not_name_stays_in_the_store(tmp_path: Path) -> None:
    robot = cia402_robot()
    board = next(line for line in CIA402.splitlines(keepends=True) if "io/board" in line)
    fewer = compiled(CIA402.replace(board, ""))
    memory = stored(tmp_path / "memory.json", SimulatedRobot(robot), fewer)
    without = SimulatedRobot(fewer, nonvolatile=memory)
    without.clone(FL, "fl_clone")
    assert stored(tmp_path / "memory.json", without, robot) == memory


def test_an_unknown_motor_is_an_error_of_the_store(tmp_path: Path) -> None:
    robot, path = cia402_robot(), tmp_path / "memory.json"
    memory = {
        FL: {"motors": {"propulsion": "fl_drive_propulsio"}},
        "not_of_this_robot": {"motors": {"propulsion": "its_own"}},
    }
    path.write_text(json.dumps(memory, indent=1), encoding="utf-8")
    report = Report()
    assert read_memory(path, robot, report) is None
    (diagnostic,) = report
    assert diagnostic.code.name == "motor-unknown"
    assert diagnostic.span.line == 4
    assert "did you mean `fl_drive_propulsion`?" in str(diagnostic.hint)
