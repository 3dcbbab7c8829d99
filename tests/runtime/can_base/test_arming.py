"""A robot on its bus moves only after it was armed, and each reason against it is named."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest

from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.simulation.bus.robots import ROBOTS, roboteq
from tests.slow import mostly_exhaustive
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.runtime.service_table import Caller, ServiceError

both = pytest.mark.parametrize("kind", mostly_exhaustive(ROBOTS))


def ready(kind: str = "Thorvald script") -> Rig:
    rig = Rig(ROBOTS[kind]())
    rig.ready()
    return rig


@both
def test_a_robot_that_is_not_armed_stands(kind: str) -> None:
    rig = ready(kind)
    rig.run(0.5)  # zero is commanded
    rig.twist = FORWARD
    rig.run(1.0)
    assert rig.speed() == 0.0
    assert rig.driven.driver.state.hold_reason == "disarmed"
    rig.arm()
    rig.twist = FORWARD
    rig.run(1.0)
    assert rig.speed() > 0.4


@both
def test_a_disarmed_robot_ramps_to_rest(kind: str) -> None:
    rig = ready(kind)
    rig.drive()
    rig.driven.disarm()
    speeds = []
    for _ in range(100):
        rig.run(rig.base.period)
        speeds.append(rig.speed())
    assert speeds[-1] == 0.0
    assert speeds[2] > 0.3  # ramped, not dropped
    assert rig.state is BaseState.READY


def test_faults_stops_and_homing_disarm() -> None:
    rig = ready()
    for stop in (
        lambda: rig.base.state_machine.fail("injected fault"),
        lambda: rig.driven.safety_stop(),
        lambda: rig.driven.home_steering(),
    ):
        rig.arm()
        assert rig.driven.armed
        stop()
        rig.run(0.1)
        assert not rig.driven.armed
        rig.driven.safety_stop(False)
        if rig.state in (BaseState.FAULT, BaseState.ESTOP):
            rig.driven.reset()
        rig.until(lambda: rig.state is BaseState.READY)
        assert not rig.driven.armed


def test_automatic_arming_waits_for_zero() -> None:
    robot = roboteq()
    rig = Rig(replace(robot, driver=replace(robot.driver, arming="automatic")))
    rig.twist = FORWARD
    rig.until(lambda: rig.state is BaseState.READY)
    rig.run(1.0)
    assert rig.speed() == 0.0
    rig.twist = ZERO_TWIST
    rig.run(0.1)
    rig.twist = FORWARD
    rig.run(1.0)
    assert rig.speed() > 0.4
    rig.driven.disarm()
    rig.twist = ZERO_TWIST
    rig.run(2.0)
    assert not rig.driven.armed


# -- pre-arm checks --------------------------------------------------------------------


def test_all_reasons_are_reported_together() -> None:
    rig = ready()
    rig.twist = FORWARD
    rig.run(0.1)
    rig.stall(0.1)
    rig.run(0.1)
    rig.driven.safety_stop()
    battery = next(d for n, d in rig.simulated.devices.items() if n.startswith("battery"))
    battery.power_off()
    rig.run(1.1)
    with pytest.raises(RequestRefused) as refusal:
        rig.driven.arm()
    reasons = str(refusal.value).split("; ")
    for part in (
        "the base is estop, reset it first",
        "the safety stop is engaged",
        "a motion is commanded",
        "there was no control cycle for 120 ms, 1.2 s ago",
        "battery: no reports",
    ):
        assert any(part in reason for reason in reasons), (part, reasons)
    assert not any("not enabled" in reason for reason in reasons)  # it is a consequence


def test_a_battery_that_reports_no_voltage_refuses() -> None:
    rig = ready()
    battery = next(d for n, d in rig.simulated.devices.items() if n.startswith("battery"))
    battery.voltage = 0.0  # type: ignore[attr-defined]
    rig.run(1.0)
    with pytest.raises(RequestRefused, match="battery: reports a voltage of 0 V"):
        rig.driven.arm()


def test_a_battery_that_allows_no_discharge_refuses() -> None:
    rig = ready()
    battery = next(d for n, d in rig.simulated.devices.items() if n.startswith("battery"))
    battery.discharge_enabled = False  # type: ignore[attr-defined]
    rig.run(1.0)
    with pytest.raises(RequestRefused, match="battery: discharge is not enabled"):
        rig.driven.arm()


def test_a_source_that_commands_motion_and_a_stop_lock_refuse() -> None:
    rig = ready()
    control = rig.driven
    rig.driven.feed = None
    # A source of a low priority counts too: it would drive as soon as the other one is silent.
    control.call("twist", source="auto_nav", vx=0.0)
    control.call("twist", source="auto_nav", vx=0.3)
    control.call("twist", source="teleop_joy", vx=0.0)
    control.call("lock", name="safety_stop")
    control.call("lock", name="auto_nav_pause")
    rig.run(0.1)
    with pytest.raises(ServiceError) as refusal:
        control.call("arm")
    assert (
        str(refusal.value) == "the stop lock `safety_stop` is active; `auto_nav` commands a motion"
    )


# -- stops belong to the program that engaged them -----------------------------------------


def test_the_safety_stop_is_released_by_who_engaged_it_or_by_force() -> None:
    rig = ready()
    control = rig.driven
    rig.driven.feed = None
    rig.driven.safety_stop()  # by the program of the driver, without the control channel
    rig.run(0.1)
    other = Caller("connection 1")
    with pytest.raises(ServiceError, match="was set by this program; release it there, or with"):
        control.services.call("release_safety_stop", {}, rig.now, other)
    with pytest.raises(ServiceError, match="the safety stop is engaged"):
        control.call("reset_faults")
    control.services.call("release_safety_stop", {"force": True}, rig.now, other)
    control.call("reset_faults")
    texts = [event.text for event in rig.driven.events]
    assert "connection 1 released by force `safety_stop` of this program" in texts


# -- gaps in time and the control channel -------------------------------------------------


@both
def test_a_source_that_moves_through_a_gap_must_send_zero(kind: str) -> None:
    rig = ready(kind)
    control = rig.driven
    vx = 0.0
    refusals: list[str] = []

    def feed(driver: object, now: float) -> None:
        try:
            control.call("twist", source="teleop_joy", vx=vx)
        except ServiceError as error:
            refusals.append(str(error))
        # A source of a lower priority sends zero all the time; this releases only itself.
        control.call("twist", source="auto_nav")

    control.call("arm")
    rig.driven.feed = feed
    rig.run(2.0 * rig.base.period)
    vx = 0.8
    rig.run(2.0)
    assert rig.speed() == pytest.approx(0.8, abs=0.02)
    rig.stall(0.15)
    rig.run(2.0)
    assert rig.speed() == 0.0
    assert refusals[-1] == "no control cycle for 170 ms; command zero first"
    vx = 0.0
    rig.run(0.1)
    vx = 0.8
    rig.run(2.0)
    assert rig.speed() == pytest.approx(0.8, abs=0.02)


def test_arm_is_no_zero_of_a_source_that_moves_through_a_gap() -> None:
    """A short gap does not disarm, so that ``arm`` checks nothing."""
    rig = ready()
    control = rig.driven

    def feed(driver: object, now: float) -> None:
        control.multiplexer.publish("teleop_joy", twist, now)
        control.multiplexer.publish("auto_nav", ZERO_TWIST, now)
        if now > 2.0 + start:
            control.call("arm")

    twist = ZERO_TWIST
    control.call("arm")
    start = rig.now
    rig.driven.feed = feed
    rig.run(2.0 * rig.base.period)
    twist = FORWARD
    rig.run(1.0)
    assert rig.speed() > 0.4
    rig.stall(0.15)
    rig.run(2.0)
    assert rig.speed() == 0.0


@pytest.mark.parametrize("first", ["arm", "twist"])
def test_a_twist_at_the_time_of_arming_moves_after_zero_only(first: str) -> None:
    rig = ready()
    control = rig.driven
    rig.driven.feed = None
    forward = {"source": "teleop_joy", "vx": 0.5}
    if first == "arm":
        control.call("arm")
        with pytest.raises(ServiceError, match="before the base was armed; command zero first"):
            control.call("twist", **forward)
    else:
        control.call("twist", source="teleop_joy")
        control.call("twist", **forward)
        with pytest.raises(ServiceError, match="`teleop_joy` commands a motion"):
            control.call("arm")
    for _ in range(100):
        rig.run(rig.base.period)
        with contextlib.suppress(ServiceError):
            control.call("twist", **forward)
        assert rig.speed() == 0.0
    if first == "arm":
        control.call("twist", source="teleop_joy")
        rig.run(rig.base.period)
        control.call("twist", **forward)
        rig.run(0.3)
        assert rig.speed() > 0.2


def test_arming_with_a_held_joystick_is_refused_after_a_gap() -> None:
    """The twist of the joystick is refused, so that nothing seems to be commanded."""
    rig = ready()
    control = rig.driven

    def feed(driver: object, now: float) -> None:
        control.multiplexer.publish("teleop_joy", FORWARD, now)

    rig.driven.feed = feed
    rig.stall(0.15)
    rig.run(3.0)
    with pytest.raises(ServiceError, match="`teleop_joy` commands a motion"):
        control.call("arm")
