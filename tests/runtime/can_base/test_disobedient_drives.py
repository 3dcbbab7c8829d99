"""Drives that do not obey: noticed by their motion, and stopped by the rungs of the ladder."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from tests.chaos.chaos_robots import steered_script as two_buses
from tests.model.stops import stop_bound
from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402, each_drive, roboteq
from thorvaldc.can.canopen import HEARTBEAT, NMT, SYNC, NmtCommand
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.model.stopping import DETECTED_FAULT, DRIVER_DEAD
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector

FAST = Twist(0.8, 0.0, 0.0)
NOTICED = 0.95
"""Longest time (s) until a motor that does not follow its target is noticed."""
FL = "fl_controller"
every_drive = each_drive("robot")


def inject(rig: Rig, kind: str, **values: Any) -> None:
    fault = BusFault(kind, "main", FL, 0.0, None, SPAN, **values)
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


def driving(robot: Robot) -> Rig:
    rig = Rig(robot)
    rig.drive(FAST, 3.0)
    assert rig.speed() == pytest.approx(0.8, abs=0.02)
    return rig


def stand_within(rig: Rig, limit: float) -> None:
    rig.until(lambda: rig.speed() < 0.005, limit)


def nmt_of(rig: Rig, since: float) -> list[int]:
    """Returns the NMT commands to the drive of the fault since a time (s), without repetitions."""
    commands = [
        f.data[0] for t, f in rig.frames if f.id == NMT and f.data[1] == 1 and t > since * 1e9
    ]
    return [c for i, c in enumerate(commands) if i == 0 or commands[i - 1] != c]


def test_ignored_commands_are_noticed_when_the_client_ends() -> None:
    rig = driving(cia402())
    inject(rig, "commands_ignored")
    rig.run(1.0)
    start, rig.twist = rig.now, None
    timeout = rig.driven.driver.settings.command_timeout
    rig.until(lambda: rig.state is BaseState.FAULT, timeout + 0.8 + NOTICED)
    assert "fl_controller: the propulsion does not follow its target" in rig.reason
    stand_within(rig, 1.0 + stop_bound(rig.robot, DETECTED_FAULT).time)
    assert NmtCommand.STOP in nmt_of(rig, start)


def test_a_script_that_ignores_commands_stops_by_itself_which_is_noticed() -> None:
    rig = driving(roboteq())
    inject(rig, "commands_ignored")
    rig.until(lambda: rig.state is BaseState.FAULT, 0.5 + 0.5 + NOTICED)
    assert "fl_controller: the propulsion does not follow its target" in rig.reason
    stand_within(rig, stop_bound(rig.robot, DETECTED_FAULT).time)


@every_drive
def test_ignored_commands_end_with_a_safety_stop(robot: Callable[[], Robot]) -> None:
    rig = driving(robot())
    inject(rig, "commands_ignored")
    rig.driven.safety_stop()
    stand_within(rig, 0.6 + stop_bound(rig.robot, DETECTED_FAULT).time)
    assert "cut the power: wheel fl_wheel (fl_controller) turns with 0.80 m/s" in rig.reason


def test_a_drive_that_ignores_nmt_too_is_starved() -> None:
    """Its watchdog is the last part of it that works."""
    rig = driving(cia402())
    inject(rig, "nmt_ignored")
    inject(rig, "commands_ignored")
    start = rig.now
    rig.driven.safety_stop()
    stand_within(rig, 1.5 + stop_bound(rig.robot, DRIVER_DEAD).time)
    rig.run(1.0)
    fed = [t / 1e9 for t, frame in rig.frames if frame.id in (SYNC, HEARTBEAT + 0x7F)]
    assert max(fed) < start + 1.3, "the bus is silent"
    assert rig.now > start + 2.0


def test_a_sync_task_that_hangs() -> None:
    rig = driving(cia402())
    start = rig.now
    inject(rig, "sync_ignored")
    stand_within(rig, 0.5 + stop_bound(rig.robot, DETECTED_FAULT).time)
    assert "fl_controller: no tpdo1" in rig.reason
    rig.run(6.0)
    assert NmtCommand.RESET_NODE in nmt_of(rig, start)
    assert "cut the power: wheel fl_wheel (fl_controller) may turn" in rig.reason


def test_a_tiny_deceleration_is_noticed_and_the_quick_stop_has_its_own() -> None:
    rig = driving(cia402())
    inject(rig, "object_written", index=0x6084, value=1)
    start, rig.twist = rig.now, ZERO_TWIST
    rig.until(lambda: rig.state is BaseState.FAULT, 0.8 + NOTICED)
    assert "fl_controller: the propulsion does not follow its target" in rig.reason
    stand_within(rig, stop_bound(rig.robot, DETECTED_FAULT).time)
    rig.run(2.0)
    assert nmt_of(rig, start) == [], "a drive that obeys does not climb"
    assert "cut the power" not in rig.reason


def test_no_deceleration_at_all() -> None:
    rig = driving(cia402())
    inject(rig, "object_written", index=0x6084, value=1)
    inject(rig, "object_written", index=0x6085, value=1)
    start, rig.twist = rig.now, ZERO_TWIST
    rig.run(10.0)
    assert nmt_of(rig, start)[:2] == [NmtCommand.STOP, NmtCommand.RESET_NODE]
    assert rig.speed() < 0.005, "without torque"
    assert "cut the power: wheel fl_wheel (fl_controller) turns with 0." in rig.reason


@every_drive
@pytest.mark.parametrize("armed", [False, True])
def test_a_wheel_that_creeps_at_rest(robot: Callable[[], Robot], armed: bool) -> None:
    rig = Rig(robot())
    rig.ready()
    if armed:
        rig.arm()
    inject(rig, "pushed_motor", channel="propulsion", speed=0.5)
    rig.until(lambda: rig.state is BaseState.FAULT, 1.2)
    assert "fl_controller: the propulsion turns, although it is commanded to stand" in rig.reason


def test_a_wheel_that_creeps_slowly_may_not_go_far() -> None:
    rig = Rig(cia402())
    rig.ready()
    inject(rig, "pushed_motor", channel="propulsion", speed=0.05)
    rig.run(8.0)
    assert rig.state.drives
    rig.until(lambda: rig.state is BaseState.FAULT, 4.0)


@every_drive
@pytest.mark.parametrize("goal", [ZERO_TWIST, Twist(1.0, 0.0, 0.0)])
def test_frozen_reports_while_the_target_changes(robot: Callable[[], Robot], goal: Twist) -> None:
    rig = driving(robot())
    inject(rig, "frozen_reports")
    rig.run(1.0)
    assert rig.state is BaseState.ACTIVE, "nothing is wrong with constant reports at constant speed"
    rig.twist = goal
    rig.until(lambda: rig.state is BaseState.FAULT, 0.8 + NOTICED)
    assert "fl_controller: the propulsion does not follow its target" in rig.reason


@every_drive
def test_a_runaway_at_full_speed_is_named(robot: Callable[[], Robot]) -> None:
    rig = driving(robot())
    inject(rig, "runaway_motor", channel="propulsion", speed=12.0)
    rig.until(lambda: rig.state is BaseState.FAULT, NOTICED + 0.2)
    rig.until(lambda: "cut the power" in rig.reason, 1.0)
    assert "wheel fl_wheel (fl_controller) turns with" in rig.reason
    others = [n for n in rig.simulated.motors if n.startswith("fr_")]
    rig.run(8.0)
    assert rig.base.state_machine.ladder.is_finished
    assert all(abs(rig.simulated.motors[n].read(rig.now).velocity) < 0.01 for n in others)
    assert "fr_wheel" not in rig.reason


@every_drive
def test_the_ladder_goes_on_while_the_program_ends(robot: Callable[[], Robot]) -> None:
    rig = driving(robot())
    inject(rig, "commands_ignored")
    start = rig.now
    rig.driven.shutdown()
    assert NmtCommand.STOP in nmt_of(rig, start)
    assert rig.now - start < rig.base.state_machine.times.stop
    rig.simulated.run(0.2)
    assert rig.speed() < 0.005


@every_drive
def test_a_drive_that_obeys_is_not_asked_to_climb(robot: Callable[[], Robot]) -> None:
    rig = driving(robot())
    start = rig.now
    rig.driven.safety_stop()
    rig.run(5.0)
    assert rig.speed() == 0.0
    assert nmt_of(rig, start) == []
    assert rig.reason == "the safety stop is engaged"


def test_a_quick_stop_keeps_the_torque_until_the_wheel_stands() -> None:
    rig = driving(cia402())
    device: Any = rig.simulated.devices[FL]
    rig.driven.safety_stop()
    while rig.speed() > 0.05:
        rig.run(0.02)
        assert device.axes[0].states.state.powered, rig.speed()


def test_a_robot_that_is_pushed_without_torque_is_a_warning() -> None:
    rig = driving(cia402())
    rig.driven.safety_stop()
    rig.run(3.0)
    start = rig.now
    inject(rig, "pushed_motor", channel="propulsion", speed=1.0)
    rig.run(1.0)
    assert rig.base.warnings(rig.now) == [
        "fl_controller: propulsion turns without torque; is the robot pushed?"
    ]
    assert rig.reason == "the safety stop is engaged"
    assert nmt_of(rig, start) == []


def test_the_robot_drives_again_after_a_reset() -> None:
    rig = driving(cia402())
    inject(rig, "commands_ignored")
    rig.twist = ZERO_TWIST
    rig.until(lambda: "cut the power" in rig.reason, 4.0)
    rig.run(6.0)
    device = rig.simulated.devices[FL]
    device.power_off()
    rig.run(0.5)
    device.power_on()
    rig.run(1.0)
    rig.driven.reset()
    rig.ready()
    rig.drive(FAST, 2.0)
    assert rig.speed() == pytest.approx(0.8, abs=0.02)


def test_only_the_bus_of_the_drive_is_starved() -> None:
    robot = two_buses()
    rig = Rig(robot)
    rear: list[tuple[float, int]] = []
    rig.simulated.wire("rear").observers.append(lambda time, f, _: rear.append((time / 1e9, f.id)))
    rig.drive(FAST, 3.0)
    for kind in ("commands_ignored", "nmt_ignored"):
        fault = BusFault(kind, "front", FL, 0.0, None, SPAN)
        FaultInjector(rig.simulated, BusFaults(())).inject(fault)
    rig.simulated.devices[FL].lose_watchdog()
    rig.driven.safety_stop()
    start = rig.now
    rig.run(4.0)
    commands = [t / 1e9 for t, frame in rig.frames if frame.id == 0x201]
    assert max(commands) < start + 1.0
    assert max(t for t, cob_id in rear if cob_id == 0x202) > rig.now - 0.1
    assert rig.speed() > 0.5, "nothing else can be done"
    assert "cut the power: wheel fl_wheel" in rig.reason


def test_a_power_stage_that_returns_moves_nothing() -> None:
    """The angle from before the loss of power is old when somebody has turned the joint."""
    rig = driving(roboteq())
    device: Any = rig.simulated.devices[FL]
    device.power_stage_error = True
    rig.until(lambda: rig.state is BaseState.ESTOP, 0.5)
    rig.run(2.0)
    steering = rig.simulated.motors["fl_steering_steering"]
    steering.disturb(rig.now, push=0.5)
    rig.run(1.0)
    steering.disturb(rig.now)
    rig.run(0.2)
    turned = steering.read(rig.now).position
    assert abs(turned) > 0.2
    device.power_stage_error = False
    rig.run(1.0)
    assert steering.read(rig.now).position == pytest.approx(turned, abs=0.01)
    assert rig.state is BaseState.ESTOP
    assert all(controller.is_off for controller in rig.base.state_machine.controllers)


@every_drive
@pytest.mark.parametrize("twist", [ZERO_TWIST, FAST])
def test_random_speeds_of_a_wheel_stop_the_robot(robot: Callable[[], Robot], twist: Twist) -> None:
    rig = Rig(robot())
    rig.drive(FAST, 3.0)
    rig.twist = twist
    rig.run(3.0)
    encoder, _ = rig.simulated.devices[FL].channel_motor(0)
    assert encoder is not None
    draw = random.Random(1)
    encoder.noise = lambda: draw.uniform(-5.0, 5.0) if draw.random() < 0.3 else None
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    assert f"{FL}: the reported speed of the propulsion jumps, as no wheel can" in rig.reason
    stand_within(rig, stop_bound(rig.robot, DETECTED_FAULT).time)
    encoder.noise = lambda: None
    rig.twist = ZERO_TWIST
    rig.run(5.0)
    rig.driven.reset()
    rig.drive(FAST, 3.0)
    assert rig.speed() == pytest.approx(0.8, abs=0.02)
