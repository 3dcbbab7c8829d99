"""The driver of CiA 402 drives, by the bytes of its frames and of the reports."""

from __future__ import annotations

import struct

import pytest

from tests.simulation.bus.robots import cia402_robot
from thorvaldc.runtime.can_base.cia402_driver import Cia402Controller
from thorvaldc.runtime.can_base.motor_controller import Intent

SPEED, ANGLE = 3.652335209251527e-05, 3.5792885014872076e-05
"""Unit of the wheel speed (rad/s) and of the steering angle (rad) on the bus."""
DISABLED, READY, SWITCHED_ON, ENABLED = 0x50, 0x31, 0x33, 0x37
STOPPING, REACTING, FAULT = 0x17, 0x1F, 0x18
ATTAINED, FAILED = 1 << 12 | 1 << 10, 1 << 13
Command = tuple[int, int, int]
"""Control word, mode of operation and target in units of the bus."""


class Drive:
    """A drive with a wheel (profile velocity) and a steering joint (profile position)."""

    def __init__(self) -> None:
        robot = cia402_robot()
        bus = robot.buses[0]
        node = next(n for n in bus.nodes if n.name == "fl_controller")
        self.driver = Cia402Controller(robot, bus, node)
        self.wheel, self.steering = self.driver.axes
        self.time = 0.0

    def report(self, wheel: int, steering: int, mode: int = 1, speed: int = 0, at: int = 0) -> None:
        """Takes reports with the status words, and the mode of the steering joint."""
        self.time += 0.02
        handlers = self.driver.handlers
        handlers[0x181](struct.pack("<Hbi", wheel, 3, speed), self.time)
        handlers[0x281](struct.pack("<Hbi", steering, mode, at), self.time)

    def command(self, intent: Intent) -> list[Command]:
        frames = self.driver.cyclic_frames(intent, self.time)
        assert [frame.id for frame in frames] == [0x201, 0x301]
        first, second = (struct.unpack("<Hbi", frame.data) for frame in frames)
        return [(first[0], first[1], first[2]), (second[0], second[1], second[2])]

    def words(self, intent: Intent) -> tuple[int, int]:
        first, second = self.command(intent)
        return first[0], second[0]


def ready(homed: bool = True) -> Drive:
    drive = Drive()
    drive.report(ENABLED, ENABLED, at=1000)
    drive.steering.homed = homed
    return drive


@pytest.mark.parametrize(
    ("state", "word"),
    [
        (DISABLED, 0x06),
        (READY, 0x07),
        (SWITCHED_ON, 0x0F),
        (STOPPING, 0x00),
        (REACTING, 0x00),
        (0x00, 0x00),
    ],
)
@pytest.mark.parametrize("intent", [Intent.FOLLOW, Intent.HOME])
def test_steps_to_operation_enabled(state: int, word: int, intent: Intent) -> None:
    drive = Drive()
    assert drive.words(intent) == (0, 0), "no report yet"
    drive.report(state, state)
    assert drive.words(intent) == (word, word)
    assert drive.words(Intent.OFF) == (0, 0)
    stop = 0x02 if state == STOPPING else 0x00
    assert drive.words(Intent.QUICK_STOP) == (stop, stop), (
        "the ramp goes on until the drive ends it"
    )


def test_targets_count_while_the_drive_follows() -> None:
    drive = ready()
    drive.wheel.target, drive.steering.target = 500 * SPEED, -300 * ANGLE
    assert drive.driver.follows
    assert drive.command(Intent.FOLLOW) == [(0x0F, 3, 500), (0x3F, 1, -300)]
    assert drive.command(Intent.FOLLOW) == [(0x0F, 3, 500), (0x2F, 1, -300)], "a rising edge"
    assert drive.command(Intent.FOLLOW)[1][0] == 0x3F
    assert drive.command(Intent.QUICK_STOP) == [(0x02, 3, 0), (0x02, 1, 1000)]
    assert drive.steering.target == pytest.approx(1000 * ANGLE), "no jump to an old target"
    drive.report(SWITCHED_ON, SWITCHED_ON, at=2000)
    assert not drive.driver.follows
    assert drive.command(Intent.FOLLOW) == [(0x0F, 3, 0), (0x0F, 1, 2000)]
    drive.report(ENABLED, ENABLED, mode=6)
    assert not drive.driver.follows, "another mode"
    assert drive.words(Intent.FOLLOW)[1] == 0x0F, "no set-point in another mode"


def test_reports_of_motion() -> None:
    drive = Drive()
    drive.report(ENABLED, ENABLED, speed=-700, at=900)
    assert drive.wheel.velocity == pytest.approx(-700 * SPEED)
    assert drive.steering.position == pytest.approx(900 * ANGLE)
    drive.report(ENABLED, ENABLED, at=1000)
    assert drive.steering.velocity == pytest.approx(100 * ANGLE / 0.02)


def test_homing() -> None:
    drive = ready(homed=False)
    old = ENABLED | ATTAINED
    assert drive.command(Intent.HOME)[1][:2] == (0x0F, 6), "the mode comes first"
    for _ in range(2):
        drive.report(ENABLED, old, mode=6, at=5)
        assert drive.command(Intent.HOME)[1][:2] == (0x1F, 6)
        assert not drive.steering.homed, "the result of the previous homing"
    drive.report(ENABLED, ENABLED, mode=6, at=5)
    drive.command(Intent.HOME)
    for word in (ENABLED, ENABLED | 1 << 12, ENABLED | 1 << 10, DISABLED | ATTAINED):
        drive.report(ENABLED, word, mode=6)
        assert not drive.steering.homed
    drive.report(ENABLED, old, mode=1)
    assert not drive.steering.homed
    drive.report(ENABLED, old, mode=6, at=7)
    assert drive.steering.homed
    assert drive.steering.target == pytest.approx(7 * ANGLE)
    assert drive.command(Intent.HOME)[1][:2] == (0x0F, 1)


def test_an_interrupted_homing_begins_again() -> None:
    drive = ready(homed=False)
    for _ in range(4):
        drive.report(ENABLED, ENABLED, mode=6)
        drive.command(Intent.HOME)
    drive.command(Intent.OFF)
    drive.report(ENABLED, ENABLED | ATTAINED, mode=6)
    assert not drive.steering.homed


def test_a_homing_that_fails() -> None:
    drive = ready(homed=False)
    for _ in range(4):
        drive.report(ENABLED, ENABLED, mode=6)
        drive.command(Intent.HOME)
    drive.report(ENABLED, ENABLED | FAILED, mode=6)
    assert drive.driver.problem == "the homing of steering failed"
    drive.driver.allow_reset()
    assert drive.driver.problem == ""
    drive.report(ENABLED, ENABLED | FAILED, mode=6)
    assert drive.driver.problem == "the homing of steering failed"
    drive.driver.handle_restart()
    assert drive.driver.problem == ""
    assert not drive.driver.follows


def test_a_fault_is_reset_once() -> None:
    drive = Drive()
    drive.report(FAULT, DISABLED)
    assert drive.driver.problem == ""
    assert drive.words(Intent.FOLLOW) == (0x80, 0x06)
    for _ in range(5):
        assert drive.driver.problem == ""
        assert drive.words(Intent.FOLLOW)[0] == 0x00
    assert drive.driver.problem == "propulsion is in the state FAULT"
    assert drive.words(Intent.FOLLOW)[0] == 0x00
    drive.driver.allow_reset()
    assert drive.driver.problem == ""
    assert drive.words(Intent.OFF)[0] == 0x80
    drive.report(ENABLED, ENABLED)
    drive.words(Intent.FOLLOW)
    drive.report(REACTING, FAULT)
    assert drive.driver.problem == (
        "propulsion is in the state FAULT, steering is in the state FAULT"
    )


def test_an_emergency_counts_after_the_start_up() -> None:
    drive = ready()
    drive.driver.error_code = 0x8611
    assert drive.driver.problem == "", "the drives may still recover"
    drive.words(Intent.FOLLOW)
    assert drive.driver.problem == "emergency 0x8611"
    drive.driver.allow_reset()
    assert drive.driver.problem == ""


@pytest.mark.parametrize(
    ("wheel", "steering", "is_off", "loss"),
    [
        (DISABLED, DISABLED, True, False),
        (DISABLED & ~0x10, DISABLED, True, False),
        (READY, SWITCHED_ON, True, False),
        (READY & ~0x10, SWITCHED_ON, True, True),
        (READY, SWITCHED_ON & ~0x10, True, True),
        (DISABLED, ENABLED, False, False),
        (ENABLED & ~0x10, DISABLED, False, True),
        (STOPPING, DISABLED, False, False),
        (DISABLED, REACTING & ~0x10, False, False),
    ],
)
def test_power(wheel: int, steering: int, is_off: bool, loss: bool) -> None:
    drive = Drive()
    assert drive.driver.is_off
    drive.report(wheel, steering)
    assert drive.driver.is_off is is_off
    assert drive.driver.power_loss == ("the power stage has no voltage" if loss else "")


def test_objects_that_are_compared() -> None:
    driver = Drive().driver
    expected = {(o.index, o.subindex): o.value for o in driver.expected_objects()}
    assert expected[0x1018, 4] == 0x101
    assert expected[0x6865, 0] == 4876
    assert not {(0x6060, 0), (0x6860, 0)} & expected.keys(), "commanded in every cycle"
    assert None not in expected.values()
    indices = {o.index for o in driver.expected_objects()}
    assert indices >= {
        *(0x1005, 0x1014, 0x1016, 0x1017, 0x1018, 0x1400, 0x1600, 0x1800, 0x1A00),
        *(0x6007, 0x605A, 0x605E, 0x6084, 0x6085, 0x6807, 0x685A, 0x685E, 0x6884, 0x6885),
    }
