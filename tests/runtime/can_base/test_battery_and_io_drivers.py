"""Low and silent batteries: the robot warns, slows down, stops, and does not start."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest

from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.model.settings import AUTOMATIC, BatterySettings
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.battery_and_io_drivers import (
    BatteryDriver,
    BatteryLevel,
    BatterySupervision,
)
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector

FAST = Twist(1.2, 0.0, 0.0)


def inject(rig: Rig, kind: str, **fields: object) -> None:
    fault = BusFault(kind, "main", "battery", 0.0, None, SPAN, **fields)  # type: ignore[arg-type]
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


def with_settings(robot: Robot, settings: BatterySettings) -> Robot:
    return replace(robot, driver=replace(robot.driver, battery=settings))


def driving(settings: BatterySettings | None = None) -> Rig:
    rig = Rig(with_settings(cia402(), settings or BatterySettings()))
    rig.drive(FAST, 3.0)
    assert rig.speed() == pytest.approx(1.2, rel=0.01)
    return rig


def level(rig: Rig) -> BatteryLevel:
    return rig.base.battery_supervision.level


def test_a_low_battery_is_a_warning() -> None:
    rig = driving()
    inject(rig, "battery_charge", charge=0.18)
    rig.run(2.0)
    assert level(rig) is BatteryLevel.WARN
    assert rig.base.warnings(rig.now) == ["battery: 18 % left"]
    assert rig.speed() == pytest.approx(1.2, rel=0.01)


def test_a_lower_battery_limits_the_speed() -> None:
    rig = driving()
    top_speed = rig.robot.driver.max_linear_velocity
    inject(rig, "battery_charge", charge=0.08)
    rig.run(1.0)
    assert rig.speed() == pytest.approx(1.2, rel=0.01)  # a single wrong report changes nothing
    rig.run(2.0)
    assert level(rig) is BatteryLevel.LIMIT
    assert rig.speed() == pytest.approx(0.5 * top_speed, rel=0.01)
    assert rig.state is BaseState.ACTIVE
    rig.twist = Twist(0.3, 0.0, 0.0)
    rig.run(2.0)
    assert rig.speed() == pytest.approx(0.3, rel=0.01)


def test_an_empty_battery_stops_the_robot_with_a_ramp() -> None:
    rig = driving()
    inject(rig, "battery_charge", charge=0.0)
    speeds = []
    for _ in range(150):
        rig.run(rig.base.period)
        speeds.append(rig.speed())
    steps = [a - b for a, b in itertools.pairwise(speeds)]
    deceleration = rig.robot.driver.max_linear_acceleration
    assert max(steps) < 1.5 * deceleration * rig.base.period
    assert speeds[-1] == 0.0
    assert level(rig) is BatteryLevel.STOP
    assert rig.state is BaseState.READY
    rig.run(3.0)
    assert rig.speed() == 0.0


def test_a_silent_battery_limits_the_speed_and_then_stops_the_robot() -> None:
    rig = driving(BatterySettings(silence=4.0))
    inject(rig, "mute")
    rig.run(0.9)
    assert level(rig) is BatteryLevel.OK
    rig.run(2.5)
    assert level(rig) is BatteryLevel.LIMIT
    assert "no reports of its charge" in rig.base.warnings(rig.now)[0]
    rig.run(4.0)
    assert level(rig) is BatteryLevel.STOP
    assert rig.speed() == 0.0


def test_a_battery_that_never_reported_stops_the_robot() -> None:
    robot = with_settings(cia402(), BatterySettings(silence=6.0))
    robot = replace(robot, driver=replace(robot.driver, arming=AUTOMATIC))
    rig = Rig(robot)
    rig.simulated.devices["battery"].power_off()
    rig.ready()
    assert level(rig) is BatteryLevel.LIMIT
    rig.run(6.0)
    assert level(rig) is BatteryLevel.STOP
    assert rig.driven.driver.state.hold_reason == "disarmed: battery: no reports of its charge"


def test_the_level_has_a_hysteresis() -> None:
    rig = driving()
    for charge, expected in (
        (0.08, BatteryLevel.LIMIT),
        (0.11, BatteryLevel.LIMIT),
        (0.13, BatteryLevel.WARN),
        (0.21, BatteryLevel.WARN),
        (0.23, BatteryLevel.OK),
    ):
        inject(rig, "battery_charge", charge=charge)
        rig.run(2.0)
        assert level(rig) is expected, charge


def test_a_robot_without_battery_on_its_buses_drives() -> None:
    robot = cia402()
    bus = robot.buses[0]
    nodes = tuple(node for node in bus.nodes if node.name != "battery")
    frames = tuple(frame for frame in bus.frames if frame.producer != "battery")
    rig = Rig(replace(robot, buses=(replace(bus, nodes=nodes, frames=frames),)))
    rig.drive(FAST, 15.0)
    assert level(rig) is BatteryLevel.OK
    assert rig.speed() == pytest.approx(1.2, rel=0.01)
    assert not rig.base.warnings(rig.now)


def test_reasons_against_arming() -> None:
    rig = Rig(cia402())
    rig.ready()
    supervision = rig.base.battery_supervision
    assert list(supervision.arming_reasons(rig.now)) == []
    inject(rig, "battery_charge", charge=0.14)
    rig.run(0.3)
    assert list(supervision.arming_reasons(rig.now)) == ["battery: 14 % left, less than 15 %"]
    inject(rig, "mute")
    rig.run(1.2)
    assert list(supervision.arming_reasons(rig.now)) == ["battery: no reports of its charge"]


@pytest.mark.parametrize("charge", [0.0, 0.14])
def test_the_service_refuses_to_arm(charge: float) -> None:
    rig = Rig(cia402())
    rig.ready()
    inject(rig, "battery_charge", charge=charge)
    rig.run(0.3)
    with pytest.raises(RequestRefused, match=r"battery: .* % left, less than 15 %"):
        rig.driven.arm()
    inject(rig, "battery_charge", charge=0.9)
    rig.run(2.0)
    rig.driven.arm()


def test_an_armed_robot_is_disarmed_by_an_empty_battery() -> None:
    rig = driving()
    inject(rig, "battery_charge", charge=0.03)
    rig.run(3.0)
    assert not rig.driven.armed
    assert rig.driven.driver.state.hold_reason == "disarmed: battery: 3 % left"
    inject(rig, "battery_charge", charge=0.9)
    rig.run(3.0)
    assert rig.speed() == 0.0  # a person must arm the robot again


def test_the_lowest_battery_counts() -> None:
    rig = driving()
    (battery,) = rig.base.battery_supervision.batteries
    supervision = rig.base.battery_supervision
    spare = type(battery)(rig.robot.buses[0], replace(battery.node, name="spare"))
    supervision.batteries = [spare, battery]
    spare.state.charge, spare._charge_time = 0.07, rig.now + 10.0  # type: ignore[attr-defined]
    rig.run(2.0)
    assert level(rig) is BatteryLevel.LIMIT
    assert supervision.reason == "spare: 7 % left"


# -- exact limits, without a bus ---------------------------------------------------------------


class PlainBattery(BatteryDriver):
    """A battery whose reports a test sets."""

    warning = ""

    def __init__(self) -> None:
        (bus,) = cia402().buses
        super().__init__(bus, next(node for node in bus.nodes if node.name == "battery"))

    def report(self, charge: float, now: float) -> None:
        self.state.charge, self.state.time = charge, now


SETTINGS = BatterySettings(warn=0.5, limit=0.375, stop=0.25, arm=0.4375, speed=0.75, silence=4.0)


def supervised() -> tuple[PlainBattery, BatterySupervision]:
    battery = PlainBattery()
    supervision = BatterySupervision(SETTINGS, [battery])
    battery.report(1.0, 0.0)
    assert supervision.update(0.0) is BatteryLevel.OK
    return battery, supervision


@pytest.mark.parametrize(
    ("threshold", "at", "below", "share"),
    [
        (0.5, BatteryLevel.OK, BatteryLevel.WARN, 1.0),
        (0.375, BatteryLevel.WARN, BatteryLevel.LIMIT, 0.75),
        (0.25, BatteryLevel.LIMIT, BatteryLevel.STOP, 0.0),
    ],
)
def test_a_level_begins_below_its_threshold(
    threshold: float, at: BatteryLevel, below: BatteryLevel, share: float
) -> None:
    battery, supervision = supervised()
    for now in (1.0, 2.0):
        battery.report(threshold, now)
        supervision.update(now)
    assert supervision.level is at
    for now in (3.0, 3.875):
        battery.report(threshold - 1e-9, now)
        assert supervision.update(now) is at
    battery.report(threshold - 1e-9, 4.0)  # one second after the first report of this level
    assert supervision.update(4.0) is below
    assert supervision.speed_share == share
    assert supervision.reason == f"battery: {100 * threshold - 1e-7:.0f} % left"


def test_a_wrong_report_between_right_ones_changes_nothing() -> None:
    battery, supervision = supervised()
    for k in range(1, 30):
        battery.report(0.0 if k % 3 else 1.0, 0.5 * k)
        assert supervision.update(0.5 * k) is BatteryLevel.OK


def test_a_silent_battery_has_exact_limits() -> None:
    battery, supervision = supervised()
    battery.report(1.0, 2.0)
    expected = {
        3.0: BatteryLevel.OK,
        3.125: BatteryLevel.LIMIT,
        6.0: BatteryLevel.LIMIT,
        6.125: BatteryLevel.STOP,
    }
    assert {now: supervision.update(now) for now in expected} == expected
    assert supervision.warnings() == ["battery: no reports of its charge for 4 s"]
    battery.report(1.0, 7.0)
    assert supervision.update(7.0) is BatteryLevel.OK


def test_silence_does_not_improve_the_level() -> None:
    battery, supervision = supervised()
    for now in (1.0, 2.0):
        battery.report(0.0, now)
        supervision.update(now)
    assert supervision.update(3.5) is BatteryLevel.STOP


def test_the_batteries_are_judged_ten_times_a_second() -> None:
    battery, supervision = supervised()
    battery.report(1.0, 1.0)
    supervision.update(1.0)
    battery.report(math.nan, -5.0)
    assert supervision.update(1.09) is BatteryLevel.OK
    assert supervision.update(1.101) is BatteryLevel.LIMIT


def test_charge_and_age_that_suffice_to_arm() -> None:
    battery, supervision = supervised()
    battery.report(0.4375, 1.0)
    assert list(supervision.arming_reasons(2.0)) == []
    assert list(supervision.arming_reasons(2.125)) == ["battery: no reports of its charge"]
    battery.report(0.43, 1.0)
    assert list(supervision.arming_reasons(2.0)) == ["battery: 43 % left, less than 44 %"]
    battery.report(math.nan, 1.0)
    assert list(supervision.arming_reasons(1.0)) == ["battery: no reports of its charge"]


def test_the_hysteresis_is_two_percent() -> None:
    battery, supervision = supervised()
    for now in (1.0, 2.0):
        battery.report(0.4, now)
        supervision.update(now)
    battery.report(0.5199, 3.0)
    assert supervision.update(3.0) is BatteryLevel.WARN
    battery.report(0.5201, 4.0)
    assert supervision.update(4.0) is BatteryLevel.OK
