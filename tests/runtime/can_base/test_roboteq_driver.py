"""The driver of the Roboteq script, by the bytes of its frames and of the reports."""

from __future__ import annotations

import struct

import pytest

from tests.examples import example_robot
from thorvaldc.can.frame import CanFrame
from thorvaldc.runtime.can_base.motor_controller import Intent
from thorvaldc.runtime.can_base.roboteq_driver import RoboteqScriptController

SPEED = 0.007479982508547127
"""Least command of a wheel speed (rad/s)."""
STEERING = 0.0030780277589999997
"""Least command of a steering angle (rad)."""
DRIVE, HOME, OFF = 0, 1, 2


def make(name: str) -> RoboteqScriptController:
    robot = example_robot(name)
    return RoboteqScriptController(robot, robot.buses[0], robot.buses[0].nodes[0])


def steered() -> RoboteqScriptController:
    """A wheel that is driven and steered: node 3."""
    return make("4wd4ws_slim")


def two_wheels() -> RoboteqScriptController:
    """A left and a right wheel: node 1."""
    return make("2wd0ws_greenhouse")


def report(driver: RoboteqScriptController, name: str, data: bytes, time: float) -> None:
    driver.handlers[driver.codecs[name].key](data, time)


def state(*flags: int, temperature: int = 30, voltage: int = 480) -> bytes:
    return struct.pack("<HhhH", sum(1 << flag for flag in flags), temperature, 15, voltage)


def constant(content: int, data: bytes) -> bytes:
    return bytes([0, 0, 0, content]) + data


def home(driver: RoboteqScriptController, time: float = 1.0) -> None:
    report(driver, "tpdo1", struct.pack("<hhi", 0, 0, 10_000), time)
    report(driver, "tpdo4", constant(1, b"\1\0\0\0"), time)
    assert driver.homed


def modes(driver: RoboteqScriptController, intent: Intent, now: float) -> tuple[int, int] | None:
    """Returns the modes that the driver sends, without the setting of the period of TPDO 4."""
    for _ in range(2):
        frame = driver.occasional_frame(intent, now)
        if frame is None or frame.id == driver.codecs["rpdo3"].key:
            break
    if frame is None:
        return None
    first, second = struct.unpack("<ii", frame.data)
    return first, second


def test_speeds_of_two_wheels() -> None:
    driver = two_wheels()
    driver.axes[0].target, driver.axes[1].target = 100 * SPEED, -200 * SPEED
    frames = driver.cyclic_frames(Intent.FOLLOW, 1.0)
    assert frames == [
        CanFrame(0x201, struct.pack("<ii", 1, 100)),
        CanFrame(0x501, struct.pack("<ii", 0, -200)),
    ]
    for intent in (Intent.OFF, Intent.HOME, Intent.QUICK_STOP):
        frames = driver.cyclic_frames(intent, 1.0)
        assert [struct.unpack("<ii", frame.data)[1] for frame in frames] == [0, 0]
    assert struct.unpack("<ii", driver.cyclic_frames(Intent.OFF, 1.0)[0].data)[0] == 5


def test_the_angle_is_commanded_after_the_homing() -> None:
    driver = steered()
    driver.axes[0].target = 100 * SPEED
    (frame,) = driver.cyclic_frames(Intent.FOLLOW, 1.0)
    assert frame == CanFrame(0x203, struct.pack("<ii", 1, 100))
    home(driver)
    driver.axes[1].target = 200 * STEERING
    assert len(driver.cyclic_frames(Intent.HOME, 1.0)) == 1
    _, frame = driver.cyclic_frames(Intent.FOLLOW, 1.0)
    top_speed, angle = struct.unpack("<ii", frame.data)
    assert (frame.id, angle) == (0x503, 200)
    assert top_speed == pytest.approx(driver.axes[1].actuator.max_velocity / 0.00244346, rel=0.01)
    _, frame = driver.cyclic_frames(Intent.OFF, 1.0)
    position = 10_000 * 3.5792885014872076e-05
    assert struct.unpack("<ii", frame.data)[1] == round(position / STEERING)
    assert driver.axes[1].target == pytest.approx(position)


def test_motion_reports() -> None:
    driver = steered()
    report(driver, "tpdo1", struct.pack("<hhi", 1000, -500, 20_000), 1.0)
    wheel, steering = driver.axes
    assert wheel.time == 1.0
    assert wheel.velocity == pytest.approx(1000 * 0.002493327502849042)
    assert steering.position == pytest.approx(20_000 * 3.5792885014872076e-05)
    assert steering.velocity == pytest.approx(-500 * 0.0024434609503486003)


def test_modes_are_sent_after_a_change_and_once_a_second() -> None:
    driver = two_wheels()
    assert modes(driver, Intent.OFF, 0.0) == (OFF, OFF)
    assert driver.is_off
    assert not driver.follows
    assert modes(driver, Intent.OFF, 1.0) is None
    assert modes(driver, Intent.OFF, 1.01) == (OFF, OFF)
    assert modes(driver, Intent.FOLLOW, 1.02) == (DRIVE, DRIVE)
    assert driver.follows
    assert not driver.is_off
    assert modes(driver, Intent.HOME, 1.03) is None, "nothing to home"
    driver.handle_restart()
    assert modes(driver, Intent.FOLLOW, 1.04) == (DRIVE, DRIVE)


def test_the_homing_mode_is_sent_once() -> None:
    driver = steered()
    assert modes(driver, Intent.HOME, 0.0) == (DRIVE, HOME)
    assert modes(driver, Intent.HOME, 5.0) is None
    home(driver, 5.0)
    assert modes(driver, Intent.HOME, 5.1) == (DRIVE, DRIVE)
    driver.discard_home(6.0)
    assert not driver.homed
    report(driver, "tpdo4", constant(1, b"\1\0\0\0"), 7.0)
    assert not driver.homed, "the homing has not started"
    assert modes(driver, Intent.HOME, 7.0) == (DRIVE, HOME)
    report(driver, "tpdo4", constant(1, b"\1\0\0\0"), 7.19)
    assert not driver.homed, "a report of the previous homing"
    report(driver, "tpdo4", constant(1, b"\3\0\0\0"), 7.21)
    assert not driver.homed, "it is homing"
    report(driver, "tpdo4", constant(1, b"\1\0\0\0"), 7.22)
    assert driver.homed


def test_a_home_switch_that_is_not_found() -> None:
    driver = steered()
    report(driver, "tpdo4", constant(1, bytes(4)), 0.0)
    assert driver.problem == "", "no homing was commanded"
    modes(driver, Intent.HOME, 1.0)
    report(driver, "tpdo4", constant(1, b"\2\0\0\0"), 1.3)
    assert driver.problem == ""
    report(driver, "tpdo4", constant(1, bytes(4)), 1.4)
    assert driver.problem == "the home switch was not found"
    assert driver.needs_restart
    driver.allow_reset()
    assert driver.problem == ""
    driver.handle_restart()
    report(driver, "tpdo4", constant(1, bytes(4)), 1.5)
    assert driver.problem == "", "the homing before the restart does not count"


def test_a_quick_stop_keeps_the_torque() -> None:
    driver = two_wheels()
    modes(driver, Intent.FOLLOW, 0.0)
    report(driver, "tpdo1", struct.pack("<hhi", 100, 0, 0), 1.0)
    driver.cyclic_frames(Intent.QUICK_STOP, 1.0)
    assert modes(driver, Intent.QUICK_STOP, 1.0) is None
    assert modes(driver, Intent.QUICK_STOP, 2.99) == (DRIVE, DRIVE), "repeated"
    report(driver, "tpdo1", bytes(8), 5.0)
    assert modes(driver, Intent.QUICK_STOP, 5.0) == (DRIVE, DRIVE), "repeated"
    assert modes(driver, Intent.OFF, 5.0) == (OFF, OFF), "the base takes the torque away"
    assert modes(driver, Intent.QUICK_STOP, 5.0) is None, "no torque is given back"


def test_a_quick_stop_ends_a_homing() -> None:
    driver = steered()
    assert modes(driver, Intent.HOME, 0.0) == (DRIVE, HOME)
    assert modes(driver, Intent.QUICK_STOP, 0.1) == (DRIVE, OFF)


@pytest.mark.parametrize(
    ("flags", "problem", "power_loss"),
    [
        ((), "", ""),
        ((0,), "controller not ok", ""),
        ((1,), "illegal command", ""),
        ((0, 3), "stall", ""),
        ((4,), "", "the power stage is off"),
        ((0, 4), "", "the power stage is off"),
        ((0, 3, 4), "stall", ""),
        ((5, 7), "alignment fault, propulsion encoder fault", ""),
        ((6,), "steering encoder fault", ""),
    ],
)
def test_flags(flags: tuple[int, ...], problem: str, power_loss: str) -> None:
    driver = steered()
    modes(driver, Intent.FOLLOW, 0.0)
    report(driver, "tpdo3", state(*flags, temperature=-5, voltage=513), 1.0)
    assert (driver.problem, driver.power_loss) == (problem, power_loss)
    assert driver.follows is not bool(problem or power_loss)
    assert driver.temperature == -5.0
    assert driver.supply_voltage == pytest.approx(51.3)
    driver.handle_restart()
    assert (driver.problem, driver.power_loss) == ("", "")


def test_an_emergency_is_a_problem() -> None:
    driver = steered()
    driver.error_code = 0x4310
    assert driver.problem == "emergency 0x4310"
    driver.allow_reset()
    assert driver.problem == ""


VERSION, ENCODERS = bytes([0, 0, 0, 1]), struct.pack("<HH", 1024, 1024)


@pytest.mark.parametrize(
    ("version", "encoders", "mismatch"),
    [
        (VERSION, ENCODERS, ""),
        (bytes([0, 3, 2, 1]), ENCODERS, "its script has the version 1.2.3, not 1.0.0"),
        (bytes([1, 0, 0, 1]), ENCODERS, "its script has the type 1, not 0"),
        (
            VERSION,
            struct.pack("<HH", 512, 1024),
            "its propulsion encoder is configured for 512 pulses, but the robot file has 1024",
        ),
        (
            VERSION,
            struct.pack("<HH", 1024, 2048),
            "its steering encoder is configured for 2048 pulses, but the robot file has 1024",
        ),
    ],
)
def test_identity(version: bytes, encoders: bytes, mismatch: str) -> None:
    driver = steered()
    assert {axis.actuator.encoder_ppr for axis in driver.axes} == {1024}
    report(driver, "tpdo4", constant(2, version), 1.0)
    assert driver.identity_mismatch() is None, "no state was reported"
    report(driver, "tpdo3", state(), 1.0)
    first = driver.identity_mismatch()
    assert first is None or "script" in first
    report(driver, "tpdo4", constant(3, encoders), 1.0)
    second = driver.identity_mismatch()
    assert second == (mismatch or None), "the configuration is still missing"
    report(driver, "tpdo4", constant(1, bytes(4)), 1.0)
    assert driver.identity_mismatch() == mismatch
    driver.handle_restart()
    assert driver.identity_mismatch() is None


def test_constants_come_quickly_while_the_motors_are_off() -> None:
    driver = steered()
    names = [name for name in driver.setting_names() if name == "tpdo4_cycle_time"]
    assert names
    slow, fast = driver.setting_frame(names[0], 1000.0), driver.setting_frame(names[0], 100.0)
    assert driver.occasional_frame(Intent.FOLLOW, 0.0) == slow
    assert driver.occasional_frame(Intent.FOLLOW, 0.0) != slow
    assert driver.occasional_frame(Intent.OFF, 0.1) == fast
    assert driver.occasional_frame(Intent.OFF, 0.1) != fast
    assert driver.occasional_frame(Intent.HOME, 0.2) != fast
    report_frame = driver.codecs["tpdo4"].frame.name
    assert driver.shortest_periods()[report_frame] == 0.1


def test_a_restart_loses_the_reference() -> None:
    driver = steered()
    assert driver.shortest_periods() == {driver.codecs["tpdo4"].frame.name: 0.1}
    home(driver)
    assert modes(driver, Intent.FOLLOW, 1.0) == (DRIVE, DRIVE)
    driver.error_code = 0x4310
    driver.handle_restart()
    assert not driver.homed
    assert not driver.follows
    assert driver.error_code == 0
    assert driver.identity_mismatch() is None


def test_a_quick_stop_holds_the_angle() -> None:
    driver = steered()
    home(driver)
    wheel, steering = driver.axes
    wheel.target, steering.target = 1.0, 0.1
    driver.cyclic_frames(Intent.QUICK_STOP, 1.0)
    assert (wheel.target, steering.target) == (0.0, steering.position)
    steering.target = 0.2
    driver.cyclic_frames(Intent.QUICK_STOP, 1.02)
    assert steering.target == 0.2, "the angle at the start of the stop is held"


def test_the_present_angle_becomes_zero() -> None:
    driver = steered()
    home(driver)
    assert driver.set_zero_frame() == driver.setting_frame("home_count", -10_000)
    assert driver.set_zero_frame() == driver.setting_frame("home_count", -20_000)
    assert two_wheels().set_zero_frame() is None


@pytest.mark.parametrize("value", [2.0**31, -(2.0**31) - 1, float("nan"), float("inf")])
def test_settings_that_do_not_fit(value: float) -> None:
    driver = steered()
    with pytest.raises(ValueError, match="home_count cannot be"):
        driver.setting_frame("home_count", value)
    number = struct.pack("<ii", 2, -(2**31))
    assert driver.setting_frame("home_count", -(2.0**31)) == CanFrame(0x303, number)


def test_all_required_objects_but_the_periods_of_reports_are_compared() -> None:
    """The driver changes the periods of the reports itself, by RPDO 2."""
    driver = steered()
    compared = {(o.index, o.subindex): o.value for o in driver.expected_objects()}
    required = {(o.index, o.subindex): o.value for o in driver.node.objects if o.value is not None}
    assert compared.items() <= required.items()
    periods = {(0x1800 + k, 5) for k in range(4)}
    assert required.keys() - compared.keys() == periods & required.keys()
    assert compared[0x1017, 0] == 100
    assert compared[0x1018, 1] == 1129
