"""The robot with three JK BMS in parallel on its simulated buses: state, faults, nothing sent."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from tests.examples import example_robot
from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.model.settings import BatterySettings
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryDriver, BatteryLevel
from thorvaldc.simulation.bus.fault_injection import FaultInjector

pytestmark = pytest.mark.usefixtures("jk_bms_package")
BATTERIES = ("battery_left", "battery_middle", "battery_right")


@pytest.fixture
def robot() -> Robot:
    return example_robot("jk_bms")


def inject(rig: Rig, node: str, kind: str, **fields: Any) -> None:
    fault = BusFault(kind, "batteries", node, 0.0, None, SPAN, **fields)
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


def set_charges(rig: Rig, *charges: float) -> None:
    for name, charge in zip(BATTERIES, charges, strict=True):
        inject(rig, name, "battery_charge", charge=charge)


def level(rig: Rig) -> BatteryLevel:
    return rig.base.battery_supervision.level


def drivers(rig: Rig) -> dict[str, BatteryDriver]:
    return {driver.node.name: driver for c in rig.base.connections for driver in c.batteries}


# -- frames: the examples of the document of the maker -------------------------------------------


def receive(robot: Robot, frames: dict[int, str]) -> BatteryDriver:
    """Returns the driver of the battery with the address 1 after it received frames."""
    driver = drivers(Rig(robot, power=False))["battery_middle"]
    for identifier, data in frames.items():
        driver.handlers[identifier](bytes.fromhex(data), 1.0)
    return driver


def test_status(robot: Robot) -> None:
    state = receive(robot, {0x2F5: "13 01 D7 11 33"}).state
    assert state.voltage == pytest.approx(27.5)
    assert state.current == pytest.approx(-56.7), "a charge is negative"
    assert state.charge == pytest.approx(0.51)


def test_surplus_bytes_are_ignored(robot: Robot) -> None:
    """Some versions of the firmware are reported to send eight bytes."""
    assert receive(robot, {0x2F5: "13 01 D7 11 33 00 FF FF"}).state.charge == pytest.approx(0.51)


def test_temperatures(robot: Robot) -> None:
    assert receive(robot, {0x5F5: "48 06 2F 01 3F"}).state.temperatures == [-3.0, 22.0]


def test_alarms(robot: Robot) -> None:
    driver = receive(robot, {0x7F5: "03 00 20 00"})
    assert driver.warning == "alarm: cell overvoltage, low charge"
    assert driver.state.alarms == 0x200003
    assert receive(robot, {0x7F5: "00 00 40 00"}).warning == "alarm: other 22"


# -- on the bus -----------------------------------------------------------------------------------


def test_nothing_is_sent_on_the_bus_of_the_batteries(robot: Robot) -> None:
    rig = Rig(robot)
    identifiers: set[int] = set()
    wire = rig.simulated.wire("batteries")
    wire.observers.append(lambda time, frame, _: identifiers.add(frame.id))
    rig.drive()
    sent = {frame.cob_id: frame.producer for frame in robot.buses[1].frames}
    assert {sent[identifier] for identifier in identifiers} == set(BATTERIES)


def test_each_battery_and_their_supply_are_in_the_state(robot: Robot) -> None:
    rig = Rig(robot)
    rig.ready()
    set_charges(rig, 0.9, 0.5, 0.7)
    rig.run(0.1)
    state = rig.driven.state()
    assert list(state["batteries"]) == list(BATTERIES)
    # 6 A: 50 Ah, 50 Ah and 100 Ah have their shares of it.
    currents = [battery["current"] for battery in state["batteries"].values()]
    assert currents == [pytest.approx(1.5), pytest.approx(1.5), pytest.approx(3.0)]
    assert state["supply"] == {
        "voltage": pytest.approx(51.2),
        "current": pytest.approx(6.0),
        "charge": pytest.approx((50 * 0.9 + 50 * 0.5 + 100 * 0.7) / 200),
    }
    statuses = {status.name: status for status in rig.base.component_statuses(rig.now)}
    assert statuses["supply"].values == rig.base.supply().source


def test_one_low_battery_of_several_only_warns(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    set_charges(rig, 0.0, 0.9, 0.9)
    rig.run(3.0)
    assert level(rig) is BatteryLevel.WARN
    assert rig.base.warnings(rig.now) == ["battery_left: 0 % left"]
    assert rig.speed() == pytest.approx(0.5, rel=0.01)
    statuses = {status.name: status for status in rig.base.component_statuses(rig.now)}
    assert [statuses[name].level for name in BATTERIES] == ["warning", "ok", "ok"]


def test_a_low_supply_stops_the_robot_and_refuses_to_arm(robot: Robot) -> None:
    rig = Rig(robot)
    rig.drive()
    set_charges(rig, 0.09, 0.03, 0.02)  # 4 % by capacity, 4.7 % as a plain mean
    rig.run(4.0)
    assert level(rig) is BatteryLevel.STOP
    assert rig.speed() == 0.0
    assert rig.driven.driver.state.hold_reason == "disarmed: supply: 4 % left"
    reasons = list(rig.base.arming_reasons(rig.now))
    assert reasons == ["supply: 4 % left, less than 15 %"]


def test_a_supply_without_stated_capacities_has_the_lowest_charge(robot: Robot) -> None:
    plain = [replace(b, properties=(("voltage", 51.2),)) for b in robot.batteries]
    rig = Rig(replace(robot, batteries=tuple(plain)))
    rig.ready()
    set_charges(rig, 0.9, 0.5, 0.7)
    rig.run(0.1)
    assert rig.driven.state()["supply"]["charge"] == pytest.approx(0.5)


def test_separate_batteries_have_no_supply_and_the_lowest_counts(robot: Robot) -> None:
    rig = Rig(replace(robot, battery_connection="separate"))
    rig.drive()
    assert rig.driven.state()["supply"] is None
    set_charges(rig, 0.9, 0.9, 0.03)
    rig.run(3.0)
    assert level(rig) is BatteryLevel.STOP
    assert rig.base.battery_supervision.reason == "battery_right: 3 % left"


def test_one_silent_battery_stops_the_robot(robot: Robot) -> None:
    """Nothing tells whether it still supplies its share of the current."""
    settings = replace(robot.driver, battery=BatterySettings(silence=4.0))
    rig = Rig(replace(robot, driver=settings))
    rig.drive()
    inject(rig, "battery_middle", "mute")
    rig.run(2.5)
    assert level(rig) is BatteryLevel.LIMIT
    assert all(value is None for value in rig.driven.state()["supply"].values())
    rig.run(4.0)
    assert level(rig) is BatteryLevel.STOP
    assert rig.speed() == 0.0
    reasons = list(rig.base.arming_reasons(rig.now))
    assert reasons == ["battery_middle: no reports of its charge"]


def test_an_alarm_warns_and_refuses_to_arm_until_it_ends(robot: Robot) -> None:
    rig = Rig(robot)
    rig.ready()
    device: Any = rig.simulated.devices["battery_left"]
    device.alarms = 2 << 14
    rig.run(0.3)
    assert list(rig.base.arming_reasons(rig.now)) == ["battery_left: alarm: high temperature"]
    device.alarms = 0
    rig.run(4.0)
    assert list(rig.base.arming_reasons(rig.now))
    rig.run(2.0)
    assert not list(rig.base.arming_reasons(rig.now))


def test_a_second_battery_with_the_same_address_is_a_reason_not_to_arm(robot: Robot) -> None:
    rig = Rig(robot)
    rig.ready()
    inject(rig, "battery_middle", "duplicate_id", id=0)
    rig.run(2.5)
    reasons = " ".join(rig.base.arming_reasons(rig.now))
    assert "battery_left" in reasons
    assert "battery_middle: no reports of its charge" in reasons
    assert math.isnan(rig.base.supply().charge)
