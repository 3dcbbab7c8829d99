"""The robot with ODrives on its simulated bus: driving, stops, faults and what it refuses."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
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

pytestmark = pytest.mark.usefixtures("odrive_package")
LEFT, RIGHT = 0, 1
HEARTBEAT, GET_ERROR, SET_STATE, ESTIMATES, MODE, INPUT_VEL, CLEAR = 1, 3, 7, 9, 11, 13, 24
RX_SDO = 4
IDLE, CLOSED_LOOP = 1, 8
MOTOR_OVER_TEMP, UNDER_VOLTAGE, WATCHDOG = 0x2000, 0x200, 0x1000000


@pytest.fixture
def robot() -> Robot:
    return example_robot("odrive")


def device(rig: Rig, name: str = "left_controller") -> Any:
    return rig.simulated.devices[name]


def inject(rig: Rig, kind: str, node: str | None = "left_controller", **fields: Any) -> None:
    fault = BusFault(kind, "main", node, 0.0, None, SPAN, **fields)
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


def commands(rig: Rig, node: int, command: int, since: float = 0.0) -> list[CanFrame]:
    """The frames of a command to a node, without the remote frames."""
    return [
        frame
        for time, frame in rig.frames
        if frame.id == node << 5 | command and not frame.remote and time >= since * 1e9
    ]


def requested_states(frames: Iterable[CanFrame]) -> list[int]:
    return [struct.unpack("<I", frame.data)[0] for frame in frames]


def until_fault(rig: Rig, limit: float) -> float:
    return rig.until(lambda: rig.state is BaseState.FAULT, limit)


# -- driving and stopping ------------------------------------------------------------------------


def test_it_drives_half_a_metre_a_second(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive(Twist(0.5, 0.0, 0.0), 2.0)
    wheels = [rig.simulated.motors[f"{side}_drive_propulsion"] for side in ("left", "right")]
    for motor in wheels:
        state = motor.read(rig.now)
        assert state.velocity * 0.2 == pytest.approx(0.5, abs=1e-6)
        assert 0.7 < state.position * 0.2 < 1.0
    pose = rig.driven.driver.odometry.pose
    assert pose.x == pytest.approx(wheels[0].read(rig.now).position * 0.2, abs=0.02)
    assert (pose.y, pose.yaw) == pytest.approx((0.0, 0.0), abs=0.02)


def test_a_curve_and_the_reversed_motor(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive(Twist(0.4, 0.0, 0.3))
    left, right = (commands(rig, node, INPUT_VEL)[-1] for node in (LEFT, RIGHT))
    (left_velocity, _), (right_velocity, _) = (struct.unpack("<ff", f.data) for f in (left, right))
    assert left_velocity > 0.0 > right_velocity, "the right motor turns against its wheel"
    assert abs(right_velocity) > left_velocity, "the right wheel is outside in a left curve"
    speeds = [a.velocity for c in rig.base.state_machine.controllers for a in c.axes]
    assert 0.0 < speeds[0] < speeds[1]


def test_only_frames_of_cansimple_are_sent(robot: Robot) -> None:
    """No NMT, SYNC or heartbeat of a CANopen master, and no command before the comparison."""
    rig = Rig(robot)
    rig.until(lambda: rig.state is BaseState.HOMING)
    start = rig.now
    rig.drive()
    sent = {frame.cob_id for bus in robot.buses for frame in bus.frames}
    assert {frame.id for _, frame in rig.frames} <= sent
    reads = {node << 5 | RX_SDO for node in (LEFT, RIGHT)}
    from_master = {f.cob_id for bus in robot.buses for f in bus.frames if f.producer == "master"}
    before = [f for t, f in rig.frames if t < (start - 0.001) * 1e9 and f.id in from_master - reads]
    assert not before
    assert all(f.data[0] == 0 for _, f in rig.frames if f.id in reads), "endpoints are only read"


def test_the_mode_is_set_while_the_axis_is_idle(robot: Robot) -> None:
    rig = Rig(robot)
    rig.ready()
    wanted = {node << 5 | command for node in (LEFT,) for command in (MODE, SET_STATE, CLEAR)}
    order = [frame for _, frame in rig.frames if frame.id in wanted]
    assert [frame.id for frame in order] == [LEFT << 5 | MODE, LEFT << 5 | SET_STATE]
    assert struct.unpack("<II", order[0].data) == (2, 1)
    assert struct.unpack("<I", order[1].data) == (CLOSED_LOOP,)


def test_a_safety_stop_brakes_and_then_takes_the_torque_away(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    pressed = rig.now
    rig.driven.safety_stop(True)
    rig.run(0.1)
    assert 0.2 < rig.speed() < 0.5, "it brakes"
    assert not requested_states(commands(rig, LEFT, SET_STATE, pressed))
    rig.run(1.0)
    assert rig.speed() == 0.0
    assert not requested_states(commands(rig, LEFT, SET_STATE, pressed)), "it might roll"
    rig.base.state_machine.ladder.holds_without_torque = True
    rig.run(0.1)
    assert set(requested_states(commands(rig, LEFT, SET_STATE, pressed))) == {IDLE}
    assert all(not any(f.data) for f in commands(rig, LEFT, INPUT_VEL, pressed + 0.05))
    assert device(rig).state == IDLE


def test_the_shutdown_leaves_the_axes_idle(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    rig.driven.shutdown()
    assert [device(rig, f"{side}_controller").state for side in ("left", "right")] == [IDLE, IDLE]
    assert rig.speed() == 0.0


def test_without_commands_the_watchdog_of_the_odrive_stops_it(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    speeds = rig.stall(3.0)
    assert speeds[-1] == 0.0  # an axis that its watchdog disarms has no torque, and rolls out
    assert device(rig).disarm_reason == WATCHDOG
    rig.run(0.1)
    assert rig.state is BaseState.FAULT
    assert rig.reason.startswith("no control cycle for ")
    reset(rig)
    assert rig.state is BaseState.READY
    rig.run(1.0)
    assert rig.speed() == 0.0, "it does not move unasked"


def reset(rig: Rig) -> None:
    at, rig.twist = rig.now, ZERO_TWIST
    rig.until(lambda: rig.base.standing and rig.now > at + 0.1)
    rig.driven.reset()
    rig.until(lambda: rig.state in (BaseState.READY, BaseState.FAULT), 12.0)


# -- faults ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["power_cut", "mute"])
def test_a_dead_or_silent_odrive_stops_the_robot(robot: Robot, kind: str) -> None:
    rig = Rig(robot)
    rig.drive()
    inject(rig, kind)
    assert until_fault(rig, 1.0) < 0.1
    assert rig.reason.startswith("left_controller: no get_encoder_estimates for ")
    rig.run(1.0)
    assert rig.speed() == 0.0


@pytest.mark.parametrize(
    ("command", "limit", "name"),
    [(ESTIMATES, 0.1, "get_encoder_estimates"), (HEARTBEAT, 0.4, "heartbeat")],
)
def test_each_missing_report_is_a_fault(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, command: int, limit: float, name: str
) -> None:
    rig = Rig(robot)
    rig.drive()
    controller = device(rig).controller
    send = controller.send
    monkeypatch.setattr(
        controller, "send", lambda frame: frame.id == LEFT << 5 | command or send(frame)
    )
    assert until_fault(rig, 1.0) < limit
    assert f"no {name} for" in rig.reason


def test_an_odrive_that_was_never_there(robot: Robot) -> None:
    rig = Rig(robot)
    device(rig, "right_controller").power_off()
    until_fault(rig, 12.0)
    assert rig.reason == "no complete reports in time from right_controller"


def test_an_error_in_the_heartbeat_stops_the_robot_until_it_is_gone(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    device(rig).fail(MOTOR_OVER_TEMP)
    assert until_fault(rig, 1.0) < 0.2
    assert rig.reason == "left_controller: MOTOR_OVER_TEMP"
    rig.run(1.0)
    assert rig.speed() == 0.0
    assert not commands(rig, LEFT, CLEAR), "errors are cleared only after a reset"
    reset(rig)
    assert rig.state is BaseState.READY
    assert len(commands(rig, LEFT, CLEAR)) == 1
    rig.run(0.5)
    assert rig.speed() == 0.0
    rig.drive()


def test_an_error_that_comes_back_is_a_fault_again(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(robot)
    rig.drive()
    device(rig).fail(MOTOR_OVER_TEMP)
    monkeypatch.setattr(device(rig), "_clear_errors", lambda: None)
    device(rig)._add_handlers()
    until_fault(rig, 1.0)
    reset(rig)
    assert rig.state is BaseState.FAULT
    assert "MOTOR_OVER_TEMP" in rig.reason or "not enabled in time" in rig.reason
    assert len(commands(rig, LEFT, CLEAR)) == 1


def test_an_axis_that_is_disarmed_without_an_active_error(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    device(rig).disarm(WATCHDOG)
    assert until_fault(rig, 1.0) < 0.2
    assert rig.reason in (
        "left_controller: WATCHDOG_TIMER_EXPIRED",
        "left_controller: it is no longer enabled and homed",
    )


def test_a_supply_that_is_too_low_is_an_emergency_stop(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    device(rig).fail(UNDER_VOLTAGE)
    rig.until(lambda: rig.state is BaseState.ESTOP, 0.3)
    assert rig.reason == "left_controller: the supply voltage is too low"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_estimate_that_is_not_finite_stops_the_robot(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, value: float
) -> None:
    rig = Rig(robot)
    rig.drive()
    monkeypatch.setattr(device(rig).encoder, "measure", lambda _: (0.0, value))
    assert until_fault(rig, 1.0) < 0.1
    assert rig.reason.startswith("left_controller: no valid get_encoder_estimates for ")
    rig.run(1.5)
    assert rig.speed() == 0.0


@pytest.mark.parametrize("kind", ["frozen_encoder", "blocked_motor"])
def test_a_wheel_that_does_not_follow(robot: Robot, kind: str) -> None:
    rig = Rig(robot)
    rig.drive()
    inject(rig, kind, channel="axis0")
    assert until_fault(rig, 1.0) < 0.7
    assert rig.reason == "left_controller: the axis0 does not follow its target"


def test_another_master_is_detected(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    data = struct.pack("<ff", 1.0, 0.0)
    rig.simulated.run(0.005)  # between two control cycles
    inject(rig, "forged_frames", None, cob_id=LEFT << 5 | INPUT_VEL, data=data)
    assert until_fault(rig, 0.1) < 0.1
    assert "another master is on the bus: it sends commands to left_controller" in rig.reason


@pytest.mark.parametrize("kind", ["clone", "duplicate_id"])
def test_two_odrives_with_one_id(robot: Robot, kind: str) -> None:
    rig = Rig(robot)
    rig.drive()
    inject(rig, kind, **({"id": RIGHT} if kind == "duplicate_id" else {}))
    assert until_fault(rig, 1.0) < 0.6


def test_an_odrive_that_reboots(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    device(rig)._handle_reboot(CanFrame(0, b"\0"))
    assert until_fault(rig, 1.0) < 0.1
    rig.run(1.0)
    reset(rig)
    assert rig.state is BaseState.READY
    rig.drive()


# -- what it refuses -------------------------------------------------------------------------------


def test_an_odrive_without_watchdog(robot: Robot) -> None:
    rig = Rig(robot, power=False)
    device(rig).nonvolatile["enable_watchdog"] = False
    rig.simulated.power_on()
    until_fault(rig, 5.0)
    assert rig.reason == "left_controller: its watchdog is off (axis0.config.enable_watchdog)"
    assert rig.base.state_machine.mismatch
    assert not commands(rig, LEFT, SET_STATE)


def test_a_watchdog_that_is_switched_off_while_driving(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    inject(rig, "watchdog_lost")
    assert until_fault(rig, 5.0) < 3.0
    assert "its watchdog is off" in rig.reason


@pytest.mark.parametrize("timeout", [0.2, 1.0, math.nan])
def test_another_watchdog_time(robot: Robot, timeout: float) -> None:
    rig = Rig(robot, power=False)
    device(rig).nonvolatile["watchdog_timeout"] = timeout
    rig.simulated.power_on()
    until_fault(rig, 5.0)
    assert f"its watchdog time is {timeout:g} s, not 0.25 s" in rig.reason


def test_another_firmware(robot: Robot) -> None:
    rig = Rig(robot)
    device(rig, "right_controller").firmware = (0, 6, 10)
    until_fault(rig, 5.0)
    assert rig.reason == "right_controller: its firmware is 0.6.10, not 0.6.11"


def test_an_odrive_that_does_not_answer(robot: Robot) -> None:
    """A wrong endpoint, or a firmware that does not know it."""
    rig = Rig(robot)
    device(rig).endpoints = (7, 8)
    until_fault(rig, 12.0)
    assert rig.reason == "no complete reports in time from left_controller"


def test_an_odrive_that_stops_to_answer_receives_no_commands(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    inject(rig, "lost_frames", share=1.0)
    assert until_fault(rig, 3.0) < 1.8
    rig.run(1.0)
    assert rig.speed() == 0.0
