"""Services of a running robot: settings, outputs, batteries, foreign devices."""

from __future__ import annotations

import threading

import pytest

from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.runtime.can_base.test_can_base import four_wheels
from tests.simulation.bus.robots import compiled, drives
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST, Twist
from thorvaldc.simulation.bus.battery_and_io_devices import ForeignDevice, IoBoard, KcBattery
from thorvaldc.simulation.bus.roboteq_device import RoboteqController

COMMAND, STATE = 0x240, 0x1C0


# -- drives -----------------------------------------------------------------------------


def test_the_present_angle_becomes_zero_at_the_next_homing() -> None:
    rig = Rig(four_wheels())
    rig.drive(Twist(0.3, 0.0, 0.3), 3.0)
    rig.twist = ZERO_TWIST
    rig.until(lambda: rig.state is BaseState.READY)
    drive = rig.simulated.devices["fl_controller"]
    assert isinstance(drive, RoboteqController)
    angle = drive.channels[1].position
    true = drive.channels[1].state.position
    assert abs(angle) > 0.1
    rig.base.nodes.set_home_count_current_position_zero("fl_controller")
    rig.run(0.1)
    assert drive.nonvolatile["home_count"] != 0
    assert rig.simulated.devices["fr_controller"].nonvolatile["home_count"] == 0
    rig.driven.home_steering()
    rig.ready()
    assert drive.channels[1].position == pytest.approx(0.0, abs=0.015)
    assert drive.channels[1].state.position == pytest.approx(true, abs=0.02)


def test_zero_of_all_controllers_and_of_none() -> None:
    rig = Rig(four_wheels())
    rig.ready()
    rig.base.nodes.set_home_count_current_position_zero()
    with pytest.raises(RequestRefused, match="no controller `nobody`"):
        rig.base.nodes.set_home_count_current_position_zero("nobody")
    without_switch = Rig(drives())
    without_switch.ready()
    with pytest.raises(RequestRefused, match="home switch"):
        without_switch.base.nodes.set_home_count_current_position_zero()


def test_no_settings_while_a_disarmed_robot_still_moves() -> None:
    rig = Rig(four_wheels())
    rig.drive(FORWARD, 2.0)
    rig.driven.disarm()
    rig.run(0.04)
    assert rig.state is not BaseState.ACTIVE
    assert not rig.base.standing
    with pytest.raises(RequestRefused, match="the robot drives; stop it first"):
        rig.base.nodes.set_home_count_current_position_zero("fl_controller")


def test_settings_of_a_motor_controller() -> None:
    rig = Rig(four_wheels())
    rig.ready()
    rig.base.nodes.setup_motor_controller("fl_controller", "max_propulsion_speed", 300)
    rig.base.nodes.setup_motor_controller("fl_controller", "tpdo2_cycle_time", 50)
    rig.run(0.2)
    drive = rig.simulated.devices["fl_controller"]
    assert isinstance(drive, RoboteqController)
    assert drive.channels[0].max_rpm == 300
    assert drive.pdos is not None
    assert drive.pdos.sent[1].event_period == 0.05
    with pytest.raises(RequestRefused, match="no setting `max_speed`; there are direction"):
        rig.base.nodes.setup_motor_controller("fl_controller", "max_speed", 1)
    with pytest.raises(RequestRefused, match="cannot be"):
        rig.base.nodes.setup_motor_controller("fl_controller", "home_count", float("nan"))
    rig.arm()
    rig.twist = FORWARD
    rig.run(0.4)
    with pytest.raises(RequestRefused, match="stop it first"):
        rig.base.nodes.setup_motor_controller("fl_controller", "direction", 1)


def test_drive_parameters_and_odometry() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    with pytest.raises(RequestRefused):
        rig.driven.set_drive_parameters("rail")
    with pytest.raises(RequestRefused):
        rig.driven.set_drive_parameters(radii={"nobody": 0.3})
    name = rig.robot.wheels[0].name
    with pytest.raises(RequestRefused, match="the robot moves; its wheel radii"):
        rig.driven.set_drive_parameters(radii={name: 0.21})
    rig.twist = ZERO_TWIST
    rig.run(2.0)
    rig.driven.set_drive_parameters(radii={name: 0.21}, limits={"max_linear_velocity": 0.2})
    rig.twist = FORWARD
    rig.run(2.0)
    assert rig.driven.driver.parameters.radii[0] == 0.21
    assert rig.speed() < 0.22
    assert rig.driven.driver.state.pose.x > 0.5
    rig.driven.call("reset_odometry")
    assert rig.driven.driver.state.pose == ORIGIN


def test_services_of_another_thread_run_in_the_loop() -> None:
    rig = Rig(four_wheels())
    rig.ready()
    seen: list[str] = []

    def call_services() -> None:
        stop = rig.driven.submit(lambda: seen.append(threading.current_thread().name))
        stop.result(10.0)
        reset = rig.driven.submit(rig.driven.reset)
        seen.append(str(reset.exception(10.0)))

    caller = threading.Thread(target=call_services)
    caller.start()
    while caller.is_alive():
        rig.run(0.02)
    assert seen == [threading.current_thread().name, "there is nothing to reset"]


# -- outputs and batteries --------------------------------------------------------------


def test_outputs_of_an_io_board() -> None:
    rig = Rig(drives())
    board = rig.simulated.devices["board"]
    assert isinstance(board, IoBoard)
    rig.ready()
    assert board.outputs == 0b10  # relay_1_at_start; no output was switched
    rig.base.nodes.set_output("board", "beacon_red", True)
    rig.run(0.3)
    assert board.outputs == 0b110
    assert rig.base.io_data(rig.now)["board"]["beacon_red_state"] == 1
    rig.base.nodes.set_output("board", "relay_1", False)
    board.inputs = 5
    rig.run(0.3)
    assert board.outputs == 0b100
    assert rig.base.io_data(rig.now)["board"]["inputs"] == 5
    with pytest.raises(RequestRefused, match="no output `horn`; it has relay_0"):
        rig.base.nodes.set_output("board", "horn", True)
    with pytest.raises(RequestRefused, match="no IO board `bord`; there are board"):
        rig.base.nodes.set_output("bord", "relay_0", True)


def test_the_battery_driver_decodes_all_three_frames() -> None:
    """The original software decoded one and relayed two as frames of foreign devices."""
    rig = Rig(drives())
    battery = rig.simulated.devices["battery"]
    assert isinstance(battery, KcBattery)
    battery.voltage, battery.current, battery.charge, battery.health = 47.5, -3.25, 0.64, 0.9
    battery.temperatures = [21, 22, 23, 24, 25, -6]
    rig.ready()
    state = rig.base.batteries()["battery"]
    assert state.voltage == 47.5
    assert state.current == -3.25
    assert state.charge == pytest.approx(0.64, abs=0.011)
    assert state.health == 0.9
    assert state.cycles == 12
    assert state.temperatures == [21, 22, 23, 24, 25, -6]
    assert rig.base.nodes.from_devices() == [] or all(
        r.frame.id == STATE for r in rig.base.nodes.from_devices()
    )
    assert rig.base.warnings(rig.now) == []
    battery.charge, battery.alarms = 0.05, 0x10
    rig.run(0.3)
    assert rig.base.warnings(rig.now) == ["battery: alarms 0x0010"]
    battery.alarms = 0
    rig.run(1.2)
    assert rig.base.warnings(rig.now) == ["battery: 5 % left"]
    battery.power_off()
    rig.run(1.5)
    assert rig.base.warnings(rig.now) == ["battery: no reports of its charge for 1 s"]
    assert rig.state is BaseState.READY  # a battery drives nothing


# -- foreign devices --------------------------------------------------------------------


def test_frames_of_foreign_devices_are_relayed_both_ways() -> None:
    rig = Rig(drives())
    sprayer = rig.simulated.devices["sprayer"]
    assert isinstance(sprayer, ForeignDevice)
    rig.ready()
    rig.base.nodes.from_devices()
    rig.base.nodes.send_to_device(CanFrame(COMMAND, b"\x01\x02"), rig.now)
    rig.run(0.1)
    assert sprayer.commands == [CanFrame(COMMAND, b"\x01\x02")]
    assert [relayed.frame.id for relayed in rig.base.nodes.from_devices()] == [
        STATE
    ]  # its response
    rig.base.nodes.mute_devices()
    with pytest.raises(RequestRefused, match="muted"):
        rig.base.nodes.send_to_device(CanFrame(COMMAND, b""), rig.now)
    rig.base.nodes.mute_devices(False)
    rig.run(0.2)
    rig.base.nodes.send_to_device(CanFrame(COMMAND, b""), rig.now)
    assert rig.base.nodes.relay_drops() == {"0x240 muted": 1}


@pytest.mark.parametrize("cob_id", [0x000, 0x080, 0x201, 0x601, 0x700 + 127, STATE, 0x241])
def test_no_other_frame_is_relayed(cob_id: int) -> None:
    """In the original software any program could send any identifier through the relay."""
    rig = Rig(drives())
    rig.ready()
    at = rig.now
    with pytest.raises(RequestRefused, match="not allowed"):
        rig.base.nodes.send_to_device(CanFrame(cob_id, b"\xde\xad"), rig.now)
    rig.run(0.2)
    assert not [f for t, f in rig.frames if t / 1e9 > at and f.data == b"\xde\xad"]
    assert rig.base.nodes.relay_drops() == {f"{cob_id:#05x} not allowed": 1}


# -- several buses ----------------------------------------------------------------------

TWO_BUSES = """
thorvaldc: 1
name: two_buses
buses: {left: {bitrate: 500 kbit/s}, right: {bitrate: 250 kbit/s}}
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, height: 650 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: {id: 1, bus: left}}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: {id: 1, bus: right}}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, can: {id: 2, bus: left}}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, can: {id: 2, bus: right}}
"""


def two_buses() -> Robot:
    return compiled(TWO_BUSES)


def test_a_robot_with_two_buses_drives_and_stops_as_one() -> None:
    rig = Rig(two_buses())
    rig.drive(Twist(0.4, 0.0, 0.0), 3.0)
    assert rig.driven.driver.state.pose.x > 0.5
    for name, wire in rig.simulated.wires.items():
        assert wire.frames > 500, name
    rig.simulated.devices["fr_controller"].power_off()
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    rig.until(lambda: rig.speed() == 0.0, 2.0)
    rig.driven.shutdown()
