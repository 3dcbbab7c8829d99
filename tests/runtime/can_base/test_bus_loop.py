"""The rules of the control cycle, the watchdogs and the state machine, in virtual time."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable
from dataclasses import replace

import pytest

from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.runtime.can_base.test_can_base import four_wheels
from tests.simulation.bus.robots import cia402_robot, drives
from tests.slow import mostly_exhaustive
from thorvaldc.can.canopen import NmtState
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.motor_controller import Intent
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.cia402_device import Cia402Drive
from thorvaldc.simulation.bus.roboteq_device import RoboteqController
from thorvaldc.simulation.bus.wire import CanController

SYNC, MASTER_HEARTBEAT = 0x080, 0x77F
PERIOD = 0.02

both = pytest.mark.parametrize(
    "make", mostly_exhaustive([drives, four_wheels]), ids=["cia402", "roboteq"]
)
Make = Callable[[], Robot]


def device(rig: Rig, name: str = "fl_controller") -> CanopenDevice:
    simulated_device = rig.simulated.devices[name]
    assert isinstance(simulated_device, CanopenDevice)
    return simulated_device


def commands(rig: Rig) -> set[int]:
    """Returns the COB-IDs of the frames that the master sends in every cycle."""
    return {
        f.cob_id
        for bus in rig.robot.buses
        for f in bus.frames
        if f.producer == "master" and f.kind == "pdo" and f.period is not None
    }


def cycles(rig: Rig, start: float, end: float) -> list[list[CanFrame]]:
    """Returns the frames that the master sent between two times (s), cycle by cycle."""
    master = {f.cob_id for f in rig.robot.buses[0].frames if f.producer == "master"}
    by_cycle: dict[int, list[CanFrame]] = {}
    for time, frame in rig.frames:
        seconds = time / 1e9
        if start <= seconds < end and frame.id in master:
            by_cycle.setdefault(math.floor((seconds + 1e-9) / PERIOD), []).append(frame)
    return list(by_cycle.values())


# -- a cycle ------------------------------------------------------------------


@both
def test_commands_in_order_then_sync_then_the_heartbeat(make: Make) -> None:
    rig = Rig(make())
    rig.drive(seconds=1.0)
    command_ids = sorted(commands(rig))
    for cycle in cycles(rig, rig.now - 0.5, rig.now):
        ids = [frame.id for frame in cycle]
        assert ids[: len(command_ids) + 1] == [*command_ids, SYNC]
        assert MASTER_HEARTBEAT not in ids[: len(command_ids) + 1]
    heartbeats = [t / 1e9 for t, f in rig.frames if f.id == MASTER_HEARTBEAT]
    gaps = [b - a for a, b in itertools.pairwise(heartbeats)]
    assert max(gaps) < 0.125
    assert min(gaps) > 0.075


def test_a_cycle_starts_every_20_ms() -> None:
    rig = Rig(four_wheels())
    rig.drive(seconds=1.0)
    syncs = [t for t, f in rig.frames if f.id == SYNC]
    gaps = [(b - a) / 1e9 for a, b in itertools.pairwise(syncs)]
    assert max(gaps) < 0.022
    assert min(gaps) > 0.018


def test_nothing_is_sent_outside_the_loop() -> None:
    """When the loop hangs nothing is sent any more, and the drives stop by themselves."""
    for make in (four_wheels, drives):
        rig = Rig(make())
        rig.drive()
        hung_at = rig.now + 0.005  # frames that were queued before are still sent
        rig.simulated.run(3.0)
        master = {f.cob_id for f in rig.robot.buses[0].frames if f.producer == "master"}
        late = [f for t, f in rig.frames if t / 1e9 > hung_at and f.id in master]
        assert late == []
        assert rig.speed() == 0.0


def test_an_exception_in_the_cycle_leaves_no_heartbeat() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    heartbeats = len([f for _, f in rig.frames if f.id == MASTER_HEARTBEAT])

    def broken(*_: object) -> None:
        raise ZeroDivisionError

    rig.driven.feed = broken
    for _ in range(20):
        with pytest.raises(ZeroDivisionError):
            rig.run(PERIOD)
        rig.simulated.run(PERIOD)
    assert len([f for _, f in rig.frames if f.id == MASTER_HEARTBEAT]) <= heartbeats + 1


def test_an_incomplete_cycle_has_neither_sync_nor_heartbeat() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    send = rig.interface.send
    refused: list[int] = []

    def failing(frame: CanFrame, timeout: float = 0.0) -> bool:
        if frame.id == 0x203:
            refused.append(frame.id)
            return False
        return send(frame, timeout)

    rig.interface.send = failing  # type: ignore[method-assign]
    at, complete = rig.now, rig.base.cycles
    rig.run(2 * PERIOD)
    sent = [f.id for t, f in rig.frames if t / 1e9 > at + 0.001]
    assert refused
    assert SYNC not in sent
    assert MASTER_HEARTBEAT not in sent
    assert rig.base.cycles == complete
    assert rig.base.incomplete == 2
    assert rig.state is BaseState.ACTIVE
    rig.run(3 * PERIOD)
    assert rig.state is BaseState.FAULT
    assert "frames cannot be sent" in rig.reason


def test_overruns_are_counted_and_never_caught_up() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    at = rig.now

    def slow(runner: object, state: object) -> None:
        if rig.now < at + 1.5 * PERIOD:
            rig.interface.sleep(0.03)  # longer than a cycle: the next one is skipped

    rig.driven.run(at + 0.5, watch=slow)
    timing = rig.driven.timing
    assert timing.overruns >= 1
    assert timing.skipped == timing.overruns
    syncs = [t / 1e9 for t, f in rig.frames if f.id == SYNC and t / 1e9 > at]
    gaps = [b - a for a, b in itertools.pairwise(syncs)]
    assert min(gaps) > 0.018  # no burst
    assert max(gaps) < 0.045
    # The loop is back on its old deadlines.
    grid = [(s - at) / PERIOD for s in syncs[-5:]]
    assert all(abs(g - round(g)) < 0.12 for g in grid)


def test_commands_that_are_not_finite_stop_the_robot() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    n = len(rig.robot.wheels)
    bad = JointCommands([1.0] * (n - 1) + [math.nan], [0.0] * n)
    rig.base.read(rig.now)
    earlier = len(rig.frames)
    rig.base.write(bad, rig.now)
    assert rig.state is BaseState.FAULT
    assert "finite" in rig.reason
    rig.simulated.run(0.01)
    speeds = [
        struct.unpack("<ii", f.data)[1] for _, f in rig.frames[earlier:] if f.id & 0x780 == 0x200
    ]
    assert speeds
    assert not any(speeds)


# -- commands ------------------------------------------------------------------


def test_after_a_stale_command_the_robot_ramps_to_rest_and_holds_its_steering() -> None:
    rig = Rig(four_wheels())
    rig.drive(Twist(0.6, 0.0, 0.4), 3.0)
    angles = rig.driven.driver.state.joints
    assert angles is not None
    steering_angles = list(angles.angles)
    rig.twist = None
    took = rig.until(lambda: rig.state is BaseState.STOPPING)
    assert 0.48 < took < 0.56
    speeds = [rig.speed()]
    while rig.state is BaseState.STOPPING:
        rig.run(PERIOD)
        speeds.append(rig.speed())
        joints = rig.driven.driver.state.joints
        assert joints is not None
        assert list(joints.angles) == pytest.approx(steering_angles, abs=0.02)
    assert speeds[-1] < 0.02
    largest = max(a - b for a, b in itertools.pairwise(speeds))
    limit = rig.robot.driver.max_linear_acceleration
    assert largest < 2.0 * limit * PERIOD  # ramped, not dropped
    assert rig.state is BaseState.READY


def test_a_command_from_before_the_start_does_not_move_it() -> None:
    """A joystick that is deflected during the start: the robot stands until it was centred."""
    robot = four_wheels()
    rig = Rig(replace(robot, driver=replace(robot.driver, arming="automatic")))
    rig.twist = FORWARD
    rig.until(lambda: rig.state is BaseState.READY)
    rig.run(1.0)
    assert rig.state is BaseState.READY
    assert rig.speed() == 0.0
    assert "a motion is commanded" in rig.driven.driver.state.hold_reason
    rig.twist = ZERO_TWIST
    rig.run(0.1)
    rig.twist = FORWARD
    rig.run(1.0)
    assert rig.state is BaseState.ACTIVE


# -- health ------------------------------------------------------------------


def lose(rig: Rig, cob_id: int, number: int) -> None:
    """Lets the master lose the next ``number`` frames of an identifier."""
    remaining = [number]

    def accepts(receiver: CanController, frame: CanFrame) -> bool:
        is_own = receiver is rig.interface.controller  # type: ignore[attr-defined]
        if is_own and frame.id == cob_id and remaining[0] > 0:
            remaining[0] -= 1
            return False
        return True

    rig.interface.wire.filters.append(accepts)  # type: ignore[attr-defined]


@both
def test_one_missed_report_is_tolerated_two_are_a_fault(make: Make) -> None:
    rig = Rig(make())
    rig.drive()
    lose(rig, 0x181, 1)
    rig.run(0.5)
    assert rig.state is BaseState.ACTIVE
    at = rig.now
    lose(rig, 0x181, 3)
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    assert rig.now - at < 0.085
    assert "no tpdo1 for" in rig.reason


@both
def test_a_missing_heartbeat_is_a_fault(make: Make) -> None:
    rig = Rig(make())
    rig.drive()
    at = rig.now
    device(rig).heartbeat_stopped = True
    rig.until(lambda: rig.state is BaseState.FAULT, 2.0)
    assert 0.18 < rig.now - at < 0.34
    assert "fl_controller: no heartbeat" in rig.reason


@both
def test_a_device_error_of_one_wheel_stops_all(make: Make) -> None:
    rig = Rig(make())
    rig.drive()
    device(rig).emergency(0x3210)
    at = rig.now
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    assert rig.now - at < 0.045
    assert "emergency 0x3210" in rig.reason
    rig.until(lambda: rig.speed() == 0.0, 2.0)
    rig.run(0.5)
    intents = {rig.base.state_machine.intent}
    assert intents == {Intent.QUICK_STOP}


@both
def test_a_node_that_restarts_is_a_fault_and_unhomed(make: Make) -> None:
    rig = Rig(make())
    rig.drive()
    device(rig).power_off()
    rig.simulated.timeline.after(10_000_000, device(rig).power_on)
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    rig.run(1.0)
    controller = next(
        c for c in rig.base.state_machine.controllers if c.node.name == "fl_controller"
    )
    assert not controller.homed
    rig.twist = ZERO_TWIST
    rig.run(0.1)
    rig.base.changes.clear()
    rig.driven.reset()
    rig.ready()
    names = [change.state for change in rig.base.changes]
    assert names == [
        BaseState.PREOP,
        BaseState.CONFIG,
        BaseState.STANDBY,
        BaseState.HOMING,
        BaseState.READY,
    ]
    rig.drive()


def test_a_driver_that_was_late_itself_does_not_judge_silence() -> None:
    """A pause of the driver of 80 ms is no silence of the nodes; silence after it is."""
    rig = Rig(four_wheels())
    rig.drive()
    drain = rig.base.connections[0].receiver.drain
    rig.simulated.run(0.08)
    rig.base.connections[0].receiver.drain = list  # type: ignore[method-assign]
    rig.run(PERIOD)  # the receiving thread has not run yet
    rig.base.connections[0].receiver.drain = drain  # type: ignore[method-assign]
    rig.run(0.5)
    assert rig.state.drives
    device(rig).power_off()
    rig.simulated.run(0.08)
    rig.until(lambda: rig.state is BaseState.FAULT, 0.1)


def test_a_node_that_leaves_operational_is_a_fault() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    device(rig).enter(NmtState.PRE_OPERATIONAL)
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)


def test_a_bus_off_interface_is_a_fault() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    rig.interface.controller.go_bus_off()  # type: ignore[attr-defined]
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    assert "bus-off" in rig.reason
    rig.run(2.0)
    assert rig.speed() == 0.0
    rig.twist = ZERO_TWIST
    rig.run(0.1)
    rig.driven.reset()
    rig.ready()
    rig.drive()


# -- other masters ------------------------------------------------------------------


@pytest.mark.parametrize(
    "frame", [CanFrame(SYNC), CanFrame(0x000, b"\x01\x00"), CanFrame(MASTER_HEARTBEAT, b"\x05")]
)
def test_another_master_is_detected_before_anything_is_sent(frame: CanFrame) -> None:
    rig = Rig(four_wheels())
    other = rig.simulated.interface(name="other")

    def send_again() -> None:
        other.send(frame)
        rig.simulated.timeline.after(100_000_000, send_again)

    send_again()
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    assert "another master" in rig.reason
    rig.run(0.5)
    assert rig.interface.controller.sent == 0  # type: ignore[attr-defined]


def test_another_master_while_it_drives_stops_it() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    rig.simulated.interface(name="other").send(CanFrame(SYNC))
    rig.until(lambda: rig.state is BaseState.FAULT, 1.0)
    rig.until(lambda: rig.speed() == 0.0, 2.0)


# -- homing ------------------------------------------------------------------


@both
def test_no_wheel_turns_before_all_steerings_are_homed(make: Make) -> None:
    rig = Rig(make())
    rig.twist = FORWARD
    while rig.state.starts:
        rig.run(PERIOD)
        assert rig.speed() == 0.0
    assert rig.state is BaseState.READY
    assert all(c.homed for c in rig.base.state_machine.controllers)


def test_a_home_switch_that_does_not_work_is_a_fault() -> None:
    rig = Rig(four_wheels())
    broken = device(rig)
    assert isinstance(broken, RoboteqController)
    broken.home_switch_works = False
    rig.until(lambda: rig.state is BaseState.FAULT, 40.0)
    assert "fl_controller" in rig.reason
    assert rig.speed() == 0.0


def test_home_steering_homes_again() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    with pytest.raises(RequestRefused, match="not ready"):
        rig.driven.home_steering()
    rig.twist = ZERO_TWIST
    rig.until(lambda: rig.state is BaseState.READY)
    drive = device(rig)
    assert isinstance(drive, RoboteqController)
    drive.homed = False
    rig.driven.home_steering()
    assert rig.state is BaseState.HOMING
    rig.ready()
    assert drive.homed


# -- identity ------------------------------------------------------------------


def writes(rig: Rig) -> list[CanFrame]:
    """Returns the frames that change something in a device: PDOs to it, and SDO downloads."""
    pdos = {
        f.cob_id for f in rig.robot.buses[0].frames if f.producer == "master" and f.kind == "pdo"
    }
    return [
        frame
        for _, frame in rig.frames
        if frame.id in pdos or (0x600 < frame.id < 0x680 and frame.data[0] & 0xE0 == 0x20)
    ]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"version": (1, 2, 0)}, "version 1.2.0, not 1.0.0"),
        ({"controller_type": 1}, "the type 1, not 0"),
    ],
)
def test_another_script_is_refused(change: dict[str, object], reason: str) -> None:
    rig = Rig(four_wheels())
    for name, value in change.items():
        setattr(device(rig), name, value)
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert reason in rig.reason
    assert rig.base.state_machine.mismatch
    rig.run(1.0)
    assert writes(rig) == []


def test_another_encoder_is_refused() -> None:
    """One real robot has a drive with 4096 pulses among drives with 1024."""
    rig = Rig(four_wheels())
    drive = device(rig)
    assert isinstance(drive, RoboteqController)
    settings = drive.channels[0].settings
    drive.channels[0].settings = replace(settings, encoder_pulses=4096)
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert "configured for 4096 pulses, but the robot file has 1024" in rig.reason


def test_another_product_is_refused_before_any_write() -> None:
    rig = Rig(drives())
    drive = device(rig)
    assert isinstance(drive, Cia402Drive)
    drive.specification.node = replace(drive.specification.node, product_code=403)
    drive.power_off()
    drive.power_on()
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert "fl_controller: product_code (0x1018:2) is 403, but must be 402" in rig.reason
    rig.run(1.0)
    assert writes(rig) == []


def test_a_parameter_that_was_never_flashed_is_refused_before_any_write() -> None:
    rig = Rig(drives())
    rig.run(0.2)
    drive = device(rig)
    drive.objects[0x1016, 1].value = 0  # it would not stop when the master has ended
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert "heartbeat_consumer_time" in rig.reason
    assert rig.base.state_machine.mismatch
    rig.run(1.0)
    assert writes(rig) == []


def test_no_controller_responds() -> None:
    rig = Rig(four_wheels(), power=False)
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert "no controller responds" in rig.reason
    assert rig.now < 6.0


def test_one_controller_is_missing() -> None:
    rig = Rig(four_wheels())
    device(rig).power_off()
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert "no heartbeat of fl_controller" in rig.reason


# -- stop and reset ------------------------------------------------------------------


@both
def test_the_safety_stop_and_the_three_conditions_to_leave_it(make: Make) -> None:
    rig = Rig(make())
    rig.drive()
    rig.driven.safety_stop()
    rig.until(lambda: rig.state is BaseState.ESTOP, 0.05)
    rig.until(lambda: rig.speed() == 0.0, 2.0)
    rig.run(0.3)
    rig.base.state_machine.ladder.holds_without_torque = True
    rig.run(0.3)
    assert all(c.is_off for c in rig.base.state_machine.controllers)
    with pytest.raises(RequestRefused, match="release it first"):
        rig.driven.reset()
    rig.driven.safety_stop(False)
    rig.run(1.0)
    assert rig.state is BaseState.ESTOP  # the release alone does not start the robot
    with pytest.raises(RequestRefused, match="command zero first"):
        rig.driven.reset()
    rig.twist = ZERO_TWIST
    rig.run(0.05)
    rig.driven.reset()
    rig.twist = FORWARD  # too early: without a pause the base does not follow
    rig.until(lambda: rig.state is BaseState.READY)
    rig.run(1.0)
    assert rig.speed() == 0.0
    rig.twist = ZERO_TWIST
    rig.run(0.05)
    rig.drive()


def test_a_reset_without_a_fault_is_refused() -> None:
    rig = Rig(four_wheels())
    rig.ready()
    with pytest.raises(RequestRefused, match="nothing to reset"):
        rig.driven.reset()


def test_a_power_stage_without_power_is_an_emergency_stop() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    drive = device(rig)
    assert isinstance(drive, RoboteqController)
    drive.power_stage_error = True
    rig.until(lambda: rig.state is BaseState.ESTOP, 1.0)
    assert "power stage is off" in rig.reason
    rig.until(lambda: rig.speed() == 0.0, 2.0)
    drive.power_stage_error = False
    rig.twist = ZERO_TWIST
    rig.run(0.5)
    rig.driven.reset()
    rig.ready()


def test_a_cause_that_remains_leads_to_the_fault_again() -> None:
    rig = Rig(four_wheels())
    rig.drive()
    device(rig).heartbeat_stopped = True
    rig.until(lambda: rig.state is BaseState.FAULT)
    rig.twist = ZERO_TWIST
    rig.run(0.04)
    with pytest.raises(RequestRefused, match=r"wheels of .* turn; wait until they stand"):
        rig.driven.reset()
    rig.until(lambda: rig.base.standing)
    rig.driven.reset()
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert "fl_controller" in rig.reason
    assert rig.speed() == 0.0


@both
def test_the_shutdown_is_a_quick_stop_then_pre_operational(make: Make) -> None:
    rig = Rig(make())
    rig.drive(Twist(0.8, 0.0, 0.0), 3.0)
    at = rig.now
    rig.driven.shutdown()
    assert rig.now - at < 1.5
    assert rig.speed() == 0.0
    assert all(
        d.state.name == "PRE_OPERATIONAL"
        for d in rig.simulated.devices.values()
        if isinstance(d, CanopenDevice)
    )


def test_a_safety_stop_during_homing_ends_it() -> None:
    rig = Rig(cia402_robot())
    rig.until(lambda: rig.state is BaseState.HOMING)
    rig.run(1.0)
    rig.driven.safety_stop()
    rig.until(lambda: rig.state is BaseState.ESTOP, 0.1)
    rig.run(1.0)
    assert all(c.is_off for c in rig.base.state_machine.controllers)
