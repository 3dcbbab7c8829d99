"""The robot with VESCs on its simulated bus: driving, stops, faults, and frames with 29 bits."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from tests.examples import example_robot
from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector

pytestmark = pytest.mark.usefixtures("vesc_package")
LEFT, RIGHT = 0, 1
SET_CURRENT, BRAKE, SET_RPM, STATUS = 1, 2, 3, 9
RADIUS, POLE_PAIRS = 0.2, 7


@pytest.fixture
def robot() -> Robot:
    return example_robot("vesc")


def device(rig: Rig, name: str = "left_controller") -> Any:
    return rig.simulated.devices[name]


def inject(rig: Rig, kind: str, node: str | None = "left_controller", **fields: Any) -> None:
    fault = BusFault(kind, "main", node, 0.0, None, SPAN, **fields)
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


def commands(rig: Rig, node: int, command: int, since: float = 0.0) -> list[bytes]:
    return [
        frame.data
        for time, frame in rig.frames
        if frame.extended and frame.id == command << 8 | node and time >= since * 1e9
    ]


def until_fault(rig: Rig, limit: float) -> float:
    return rig.until(lambda: rig.state is BaseState.FAULT, limit)


def reset(rig: Rig) -> None:
    at, rig.twist = rig.now, ZERO_TWIST
    rig.until(lambda: rig.base.standing and rig.now > at + 0.1)
    rig.driven.reset()
    rig.until(lambda: rig.state in (BaseState.READY, BaseState.FAULT), 12.0)


# -- driving and stopping ------------------------------------------------------------------------


def test_it_drives_half_a_metre_a_second(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive(Twist(0.5, 0.0, 0.0), 2.0)
    wheels = [rig.simulated.motors[f"{side}_drive_propulsion"] for side in ("left", "right")]
    for motor in wheels:
        assert motor.read(rig.now).velocity * RADIUS == pytest.approx(0.5, abs=1e-3)
    pose = rig.driven.driver.odometry.pose
    assert pose.x == pytest.approx(wheels[0].read(rig.now).position * RADIUS, abs=0.02)
    assert (pose.y, pose.yaw) == pytest.approx((0.0, 0.0), abs=0.02)


def test_the_commands_are_electrical_revolutions_in_big_endian(robot: Robot) -> None:
    """The right motor is mounted the other way round, and is outside in a left curve."""
    rig = Rig(robot)
    rig.drive(Twist(0.4, 0.0, 0.3), 2.0)
    left, right = (struct.unpack(">i", commands(rig, n, SET_RPM)[-1])[0] for n in (LEFT, RIGHT))
    assert left > 0 > right
    assert -right > left
    motor = next(a for a in robot.actuators if a.name == "left_drive_propulsion")
    speed = rig.simulated.motors[motor.name].read(rig.now).velocity
    erpm = speed * motor.gear_ratio * POLE_PAIRS * 60.0 / math.tau
    assert left == pytest.approx(erpm, abs=1.5)


def test_all_frames_have_29_bits(robot: Robot) -> None:
    """No NMT, SYNC or heartbeat of a CANopen master; only the battery has 11 bits."""
    rig = Rig(robot)
    rig.drive()
    known = {frame.key for bus in robot.buses for frame in bus.frames}
    assert {frame.key for _, frame in rig.frames} <= known
    battery = {f.key for b in robot.buses for f in b.frames if f.producer == "battery"}
    assert {frame.key for _, frame in rig.frames if not frame.extended} == battery


def test_a_robot_at_rest_gets_no_speed(robot: Robot) -> None:
    """Below the minimum ERPM a VESC takes the torque away, so the driver brakes instead."""
    rig = Rig(robot)
    rig.ready()
    rig.run(0.5)
    assert not commands(rig, LEFT, SET_RPM)
    assert {*commands(rig, LEFT, BRAKE)} == {struct.pack(">i", 20_000)}
    assert {*commands(rig, LEFT, SET_CURRENT)} <= {bytes(4)}


def test_a_safety_stop_brakes(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    pressed = rig.now
    rig.driven.safety_stop(True)
    rig.run(0.1)
    assert commands(rig, LEFT, BRAKE, pressed)
    rig.run(1.0)
    assert rig.speed() == 0.0


def test_the_shutdown_takes_the_torque_away(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    rig.driven.shutdown()
    assert [device(rig, f"{side}_controller").current for side in ("left", "right")] == [0.0, 0.0]
    assert rig.speed() == 0.0


def test_without_commands_the_timeout_of_the_vesc_takes_the_torque_away(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    speeds = rig.stall(3.0)
    assert speeds[-1] == 0.0, "it rolls out"
    rig.run(0.1)
    assert rig.state is BaseState.FAULT
    reset(rig)
    assert rig.state is BaseState.READY
    rig.run(1.0)
    assert rig.speed() == 0.0, "it does not move unasked"


# -- faults ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["power_cut", "mute"])
def test_a_dead_or_silent_vesc_stops_the_robot(robot: Robot, kind: str) -> None:
    rig = Rig(robot)
    rig.drive()
    inject(rig, kind)
    assert until_fault(rig, 1.0) < 0.1
    assert rig.reason.startswith("left_controller: no status for ")
    rig.run(1.0)
    assert rig.speed() == 0.0


@pytest.mark.parametrize("kind", ["frozen_encoder", "blocked_motor"])
def test_a_wheel_that_does_not_follow(robot: Robot, kind: str) -> None:
    """A VESC reports no errors, so that the motion tells of them."""
    rig = Rig(robot)
    rig.drive()
    inject(rig, kind, channel="motor")
    assert until_fault(rig, 1.0) < 0.7
    assert rig.reason == "left_controller: the motor does not follow its target"


def test_another_master_is_detected(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    rig.simulated.run(0.005)  # between two control cycles
    values = {"cob_id": SET_RPM << 8 | LEFT, "data": bytes(4), "format": "extended"}
    inject(rig, "forged_frames", None, **values)
    assert until_fault(rig, 0.1) < 0.1
    assert "it sends commands to left_controller (0x00000300)" in rig.reason


def test_a_standard_frame_with_the_number_of_a_command_is_another_frame(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    other = rig.simulated.interface(name="other")
    other.send(CanFrame(SET_RPM << 8 | LEFT, struct.pack(">i", 9000)))
    other.send(CanFrame(0x109, bytes(8)))
    rig.run(0.5)
    assert rig.state is BaseState.ACTIVE
    wheel = rig.simulated.motors["left_drive_propulsion"].read(rig.now)
    assert wheel.velocity * RADIUS == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("kind", ["clone", "duplicate_id"])
def test_two_vescs_with_one_id(robot: Robot, kind: str) -> None:
    rig = Rig(robot)
    rig.drive()
    inject(rig, kind, **({"id": RIGHT} if kind == "duplicate_id" else {}))
    assert until_fault(rig, 1.0) < 0.6


def test_a_report_that_is_too_short_counts_as_missing(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(robot)
    rig.drive()
    monkeypatch.setattr(device(rig), "_send_status", lambda: None)
    device(rig)._repeat(0.02, lambda: device(rig)._report(STATUS, b"\1"))
    assert until_fault(rig, 1.0) < 0.6
