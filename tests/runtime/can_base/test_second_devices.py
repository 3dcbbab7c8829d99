"""Second devices, second masters and false reports, for both kinds of drives."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import pytest

from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402, each_drive
from thorvaldc.can.canopen import EMCY, HEARTBEAT, LSS_REQUEST
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.frame_receiver import OBSERVATION
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.fault_injection import FaultInjector

both = each_drive("make")
Make = Callable[[], Robot]
PERIOD = 0.02


def inject(rig: Rig, kind: str, node: str | None = None, **fields: object) -> None:
    fault = BusFault(kind, "main", node, 0.0, None, SPAN, **fields)  # type: ignore[arg-type]
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


def device(rig: Rig, name: str = "fl_controller") -> CanopenDevice:
    simulated_device = rig.simulated.devices[name]
    assert isinstance(simulated_device, CanopenDevice)
    return simulated_device


def until_fault(rig: Rig, limit: float) -> float:
    """Returns the time (s) until FAULT; no READY may come before."""
    took = rig.until(lambda: rig.state in (BaseState.FAULT, BaseState.READY), limit)
    assert rig.state is BaseState.FAULT
    return took


# -- before the robot is ready -----------------------------------------------------------------


@both
@pytest.mark.parametrize("delay", [0.0, 0.003, 0.3, 1.0])
def test_a_clone_on_the_bus_from_power_on(make: Make, delay: float) -> None:
    rig = Rig(make(), power=False)
    clone = rig.simulated.clone("fl_controller", "spare")
    rig.simulated.power_on()
    if delay:
        clone.power_off()
        rig.simulated.run(delay)
        clone.power_on()
    assert until_fault(rig, 5.0) < 0.3 + OBSERVATION
    assert "fl_controller" in rig.reason
    assert "is a second device with the id 1 on the bus?" in rig.reason


@both
def test_a_clone_that_was_there_long_before_the_driver(make: Make) -> None:
    """No boot-up message of the clone is received; its heartbeats are too many."""
    rig = Rig(make())
    rig.simulated.clone("fr_controller", "spare").power_on()
    rig.simulated.run(2.0)
    drop_received(rig)
    assert until_fault(rig, 5.0) < 0.3 + OBSERVATION
    assert "is a second device with the id 2 on the bus?" in rig.reason


def drop_received(rig: Rig) -> None:
    """Forgets the frames that came before the driver listened."""
    for interface in rig.interfaces.values():
        while interface.receive(0.0) is not None:
            pass


@both
def test_a_reset_does_not_help_while_the_clone_is_there(make: Make) -> None:
    rig = Rig(make(), power=False)
    clone = rig.simulated.clone("fl_controller", "spare")
    rig.simulated.power_on()
    until_fault(rig, 5.0)
    rig.driven.reset()
    assert until_fault(rig, 8.0) < 2.0
    clone.power_off()
    rig.run(0.1)
    rig.driven.reset()
    rig.until(lambda: rig.state is BaseState.READY)


@both
def test_a_drive_that_restarts_during_the_start_up(make: Make) -> None:
    """Its objects were compared before the restart, so that the comparison is worth nothing."""
    rig = Rig(make())
    rig.until(lambda: rig.state is BaseState.CONFIG)
    rig.run(0.2)
    device(rig).power_off()
    device(rig).power_on()
    until_fault(rig, 5.0)
    assert "restarted during the start-up" in rig.reason


# -- while driving -----------------------------------------------------------------------------


@both
def test_a_silent_clone_starts_while_the_robot_drives(make: Make) -> None:
    """Heartbeats of a second device, without its boot-up message."""
    rig = Rig(make())
    rig.drive()
    inject(rig, "forged_frames", cob_id=0x701, data=b"\x05", period=0.1)
    rig.until(lambda: rig.state is BaseState.FAULT, 0.7)
    assert "fl_controller: heartbeat (0x701)" in rig.reason


@both
@pytest.mark.parametrize(("period", "limit"), [(0.005, 0.2), (0.02, 0.25), (0.2, 1.5), (0.7, 8.0)])
def test_false_reports(make: Make, period: float, limit: float) -> None:
    rig = Rig(make())
    rig.drive(seconds=1.0)
    true_report = next(f.data for t, f in reversed(rig.frames) if f.id == 0x181)
    inject(rig, "forged_frames", cob_id=0x181, data=true_report, period=period)
    rig.until(lambda: rig.state is BaseState.FAULT, limit)
    assert "fl_controller: tpdo1 (0x181) comes more often than the robot file states" in rig.reason
    rig.until(lambda: rig.speed() == 0.0, 1.5)


@both
def test_every_identifier_of_the_master_from_elsewhere(make: Make) -> None:
    robot = make()
    frames = [f for f in robot.buses[0].frames if f.producer == "master" and f.kind != "relay"]
    assert {f.kind for f in frames} == {"nmt", "sync", "heartbeat", "pdo", "sdo"}
    rig = Rig(robot)
    rig.ready()
    for frame in frames:
        rig.simulated.run(0.007)  # apart from the driver's own frames
        data = bytes([0, 99]) if frame.kind == "nmt" else bytes(frame.length)
        inject(rig, "forged_frames", cob_id=frame.cob_id, data=data, duration=0.01)
        rig.run(2 * PERIOD)
        assert rig.state is BaseState.FAULT, frame.name
        assert rig.reason.startswith("another master is on the bus: it sends ")
        assert f"({frame.cob_id:#05x})" in rig.reason
        rig.run(0.5)
        rig.driven.reset()
        rig.until(lambda: rig.state is BaseState.READY)


# -- no false alarm ----------------------------------------------------------------------------


@both
def test_lost_and_late_frames_are_no_second_device(make: Make) -> None:
    rig = Rig(make())
    rig.drive(seconds=1.0)
    inject(rig, "noise", share=0.05)
    rig.run(10.0)
    assert rig.state is BaseState.ACTIVE, rig.reason


@both
def test_late_cycles_are_no_second_device(make: Make) -> None:
    rig = Rig(make())
    rig.drive(seconds=1.0)
    cycles = 0

    def late(*_: object) -> None:
        nonlocal cycles
        cycles += 1
        if cycles % 7 == 0:
            rig.interface.sleep(0.017 if cycles % 2 else 0.028)

    rig.driven.run(rig.now + 10.0, watch=late)
    assert rig.driven.timing.overruns > 10
    assert "second device" not in rig.reason
    assert "another master" not in rig.reason


def test_two_batteries_with_one_id_are_a_warning() -> None:
    rig = Rig(cia402())
    rig.drive()
    assert not rig.base.warnings(rig.now)
    inject(rig, "forged_frames", cob_id=0x3E1, period=0.1)
    rig.run(1.5)
    assert rig.state is BaseState.ACTIVE
    (warning,) = rig.base.warnings(rig.now)
    assert warning.startswith("battery: charge (0x3e1) comes more often than the robot file states")


def test_a_reset_forgets_a_second_battery_that_is_gone() -> None:
    rig = Rig(cia402())
    rig.ready()
    rig.run(1.0)
    fault = BusFault("forged_frames", "main", None, 0.0, 1.5, SPAN, cob_id=0x3E1, period=0.1)
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)
    rig.run(1.0)
    rig.driven.reset()  # it is still there, and noticed again
    rig.run(3.0)
    with pytest.raises(RequestRefused, match="battery: charge"):
        rig.driven.arm()
    rig.driven.reset()
    rig.driven.arm()
    with pytest.raises(RequestRefused, match="there is nothing to reset"):
        rig.driven.reset()


@both
def test_resets_do_not_hide_false_reports_of_a_drive(make: Make) -> None:
    """A program that resets in every cycle is not able to void the protection."""
    rig = Rig(make())
    rig.drive()
    inject(rig, "forged_frames", cob_id=0x181, period=PERIOD)

    def resets(now: float) -> None:
        with contextlib.suppress(RequestRefused):
            rig.driven.reset()

    rig.driven.before_cycle = resets
    rig.homes = False
    noticed: list[str] = []
    rig.base.state_machine.changed = lambda time, state, reason: noticed.append(reason)
    rig.run(3.0)
    assert any("comes more often" in reason for reason in noticed), noticed


# -- strangers ---------------------------------------------------------------------------------


def test_an_lss_master_is_another_master_also_if_the_damage_shows_at_the_next_start_only() -> None:
    """It stores one id in all drives, which keep their ids until then."""
    rig = Rig(cia402())
    rig.drive()
    tool = rig.simulated.interface(name="tool")
    start = rig.now
    for message in (b"\4\1", b"\x11\x09", b"\x17"):
        tool.send(CanFrame(LSS_REQUEST, message.ljust(8, b"\0")))
        rig.run(PERIOD)
    assert rig.until(lambda: rig.state is BaseState.FAULT, 0.1) <= 0.04
    assert rig.now - start < 0.2
    assert "it sends LSS requests, which change node ids (0x7e5)" in rig.reason
    rig.twist = ZERO_TWIST
    rig.run(2.0)
    stored = [rig.simulated.devices[f"{side}_controller"].nonvolatile for side in ("fl", "fr")]
    assert [memory["node_id"] for memory in stored] == [9, 9]
    rig.simulated.power_off()
    rig.simulated.power_on()
    rig.driven.reset()
    rig.until(lambda: "not pre-operational in time" in rig.reason, 10.0)
    warning = "a node on the bus `main` has the id 9, the robot file has none"
    assert warning in rig.base.warnings(rig.now)


@pytest.mark.parametrize("cob_id", [EMCY + 99, HEARTBEAT + 99])
def test_a_node_that_the_robot_file_does_not_have_is_named(cob_id: int) -> None:
    rig = Rig(cia402())
    rig.drive()
    assert rig.base.warnings(rig.now) == []
    rig.simulated.interface(name="stranger").send(CanFrame(cob_id, bytes(8)))
    rig.run(3 * PERIOD)
    assert rig.base.warnings(rig.now) == [
        "a node on the bus `main` has the id 99, the robot file has none"
    ]
    assert rig.state is BaseState.ACTIVE
