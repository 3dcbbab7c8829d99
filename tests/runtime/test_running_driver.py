"""A robot on its bus that other programs drive by services, in virtual time."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest

from tests.examples import example_robot
from tests.runtime.can_base.simulated_rig import Rig
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.service_table import ServiceError


class DrivenRobot:
    """A rig whose commands come from the services of its control."""

    def __init__(self) -> None:
        self.rig = Rig(example_robot("4wd4ws_wide"))
        self.control = self.rig.driven
        self.speeds: dict[str, float] = {}
        self.rig.driven.feed = self.feed
        self.rig.ready()
        self.call("arm")
        self.rig.run(self.rig.base.period)

    def feed(self, driver: Any, now: float) -> None:
        for source, vx in self.speeds.items():
            if source not in self.control.multiplexer.holders(now):
                self.call("twist", source=source)
            with contextlib.suppress(ServiceError):
                self.call("twist", source=source, vx=vx)

    def call(self, service: str, **arguments: Any) -> Any:
        return self.control.call(service, **arguments)


@pytest.fixture
def driven() -> DrivenRobot:
    return DrivenRobot()


def test_a_source_drives_the_robot_on_its_bus(driven: DrivenRobot) -> None:
    driven.speeds["auto_nav"] = 0.4
    driven.rig.run(2.0)
    state = driven.call("state")
    assert (state["supervisor"], state["source"]) == ("active", "auto_nav")
    assert driven.rig.speed() == pytest.approx(0.4, abs=0.02)
    assert state["batteries"]["battery_left"]["charge"] == pytest.approx(0.9)
    # The joystick has the higher priority; then its twist times out.
    driven.speeds["teleop_joy"] = 0.0
    driven.rig.run(2.0)
    assert driven.rig.speed() == 0.0
    del driven.speeds["teleop_joy"]
    driven.rig.run(2.0)
    assert driven.rig.speed() == 0.0  # the navigation takes over, and has not commanded zero
    driven.speeds["auto_nav"] = 0.0
    driven.rig.run(0.1)
    driven.speeds["auto_nav"] = 0.4
    driven.rig.run(2.0)
    assert driven.rig.speed() == pytest.approx(0.4, abs=0.02)


def test_the_load_of_the_bus_is_measured(driven: DrivenRobot) -> None:
    """With the most stuff bits that its frames can have, it is little more than on the wire."""
    driven.speeds["auto_nav"] = 0.4
    driven.rig.run(0.5)
    (wire,) = driven.rig.simulated.wires.values()
    (name,) = driven.rig.simulated.wires
    (bus,) = driven.rig.robot.buses
    busy = wire.busy
    driven.rig.run(2.5)
    load = driven.call("state")["bus_load"][name]
    actual = (wire.busy - busy) / 2.5e9
    assert 0.02 < actual <= load < 1.25 * actual
    assert load <= 1.02 * bus.load  # one control cycle of fifty
    (status,) = (s for s in driven.rig.base.component_statuses(0.0) if s.name == f"bus {name}")
    assert status.values["load"] == load


def test_without_a_source_the_robot_comes_to_rest(driven: DrivenRobot) -> None:
    driven.speeds["auto_nav"] = 0.4
    driven.rig.run(2.0)
    driven.speeds.clear()
    driven.rig.run(2.0)
    assert driven.rig.speed() == 0.0
    assert driven.rig.state is BaseState.READY


def test_the_safety_stop_switches_the_drives_off(driven: DrivenRobot) -> None:
    driven.speeds["auto_nav"] = 0.4
    driven.rig.run(2.0)
    driven.call("safety_stop")
    driven.rig.run(1.0)
    assert driven.rig.state is BaseState.ESTOP
    assert driven.rig.speed() == 0.0
    state = driven.call("state")
    assert state["fault"] == "the safety stop is engaged"
    assert state["locks"] == ["safety_stop"]
    with pytest.raises(ServiceError, match="the safety stop is engaged; release it first"):
        driven.call("reset_faults")
    driven.call("release_safety_stop")
    driven.rig.run(1.0)
    assert driven.rig.speed() == 0.0  # the release alone does not start the robot
    with pytest.raises(ServiceError, match="command zero first"):
        driven.call("reset_faults")
    driven.speeds.clear()
    driven.rig.run(1.0)
    driven.call("reset_faults")
    driven.rig.until(lambda: driven.rig.state is BaseState.READY)


def test_services_of_the_original_software(driven: DrivenRobot) -> None:
    driven.call("set_output", board="io", output="beacon_red")
    driven.call("mute_devices")
    driven.call("reset_odometry")
    driven.call("set_home_count_current_position_zero")
    driven.call("home_steering")
    assert driven.rig.state is BaseState.HOMING
    driven.rig.until(lambda: driven.rig.state is BaseState.READY)
    assert driven.call("state")["outputs"]["io"]["beacon_red"] is True
    assert driven.call("from_devices") == []


@pytest.mark.parametrize(
    ("service", "arguments", "reason"),
    [
        ("set_output", {"board": "io", "output": "beacon_blue"}, "has no output `beacon_blue`"),
        ("set_output", {"board": "x", "output": "y"}, "there is no IO board `x`"),
        ("setup_motor_controller", {"node": "x", "setting": "y", "value": 1}, "no controller `x`"),
        ("send_to_device", {"cob_id": 0x205, "data": "zz"}, "it must be bytes in hexadecimal"),
        ("send_to_device", {"cob_id": 0x900, "data": "00"}, "an identifier of 11 bits"),
        ("send_to_device", {"cob_id": 0x205, "data": "00"}, "0x205: "),
        ("reset_faults", {}, "there is nothing to reset"),
        ("from_devices", {"bus": "x"}, "there is no bus `x`"),
    ],
)
def test_refusals(
    driven: DrivenRobot, service: str, arguments: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ServiceError) as refusal:
        driven.call(service, **arguments)
    assert reason in str(refusal.value)
