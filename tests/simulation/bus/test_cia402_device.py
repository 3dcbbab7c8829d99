"""A CiA 402 drive, controlled through its objects."""

from __future__ import annotations

import itertools
import math
import struct
from typing import Any

import pytest

from tests.simulation.bus.master import Master, Refused
from tests.simulation.bus.specifications import specification
from thorvaldc.simulation.bus.cia402_device import AxisSettings, Cia402Drive
from thorvaldc.simulation.bus.process_data import Pdo
from thorvaldc.simulation.bus.simulated_motors import IdealMotor
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire

NODE = 10
COUNT = 4 * 1024 * 42 / math.tau  # counts per rad
TOP, ACCELERATION = 7.0, 7.5
STOP = math.pi
LIMIT = 3.078
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, DISABLE, RESET = 0x06, 0x07, 0x0F, 0x02, 0x00, 0x80
STATES = {
    0x40: "switch on disabled",
    0x21: "ready to switch on",
    0x23: "switched on",
    0x27: "operation enabled",
    0x07: "quick stop active",
    0x0F: "fault reaction active",
    0x08: "fault",
}


class Drive:
    """A drive and its master; the motor has mechanical stops half a turn to either side."""

    def __init__(self, position: float = 0.0, **more: Any) -> None:
        self.wire = Wire(Timeline())
        self.master = Master(VirtualTimeInterface(self.wire, "master"))
        self.motor = IdealMotor(TOP, ACCELERATION, 100.0, -STOP, STOP, position=position)
        given = {"lower": -LIMIT, "upper": LIMIT, **more}
        settings = AxisSettings(42.0, 1024, TOP, ACCELERATION, 100.0, **given)
        self.device = Cia402Drive(specification(self.wire, NODE, name="drive"))
        self.device.equip(
            [(settings, self.motor)],
            [
                Pdo(1, 0x200, 1, ((0x6040, 0, 16), (0x607A, 0, 32))),
                Pdo(2, 0x300, 255, ((0x6040, 0, 16), (0x60FF, 0, 32))),
            ],
            [Pdo(1, 0x180, 1, ((0x6041, 0, 16), (0x6064, 0, 32)))],
        )
        self.axis = self.device.axes[0]
        self.device.power_on()
        self.master.interface.sleep(0.2)
        self.master.nmt(1)

    def sleep(self, seconds: float) -> None:
        self.master.interface.sleep(seconds)
        self.master.interface.received.clear()

    def set(self, index: int, value: float, size: int = 4, subindex: int = 0) -> None:
        self.master.write(NODE, index, subindex, round(value), size)

    def get(self, index: int, subindex: int = 0) -> int:
        return self.master.number(NODE, index, subindex, signed=True)

    def control(self, *words: int) -> None:
        for word in words:
            self.set(0x6040, word, 2)

    @property
    def state(self) -> str:
        return STATES[self.word & (0x4F if self.word & 0x40 or self.word & 0x08 else 0x6F)]

    @property
    def word(self) -> int:
        return self.master.number(NODE, 0x6041)

    def enable(self, mode: int) -> None:
        self.set(0x6060, mode, 1)
        self.control(SHUTDOWN, SWITCH_ON, ENABLE)

    @property
    def joint(self) -> tuple[float, float]:
        state = self.motor.read(self.wire.timeline.seconds)
        return state.position, state.velocity


def test_factory_values() -> None:
    """Positions in encoder counts, speeds in counts/s, of a gear of 42:1 with 1024 pulses."""
    drive = Drive()
    expected = {
        (0x6007, 0): 1,
        (0x605A, 0): 2,
        (0x605C, 0): 1,
        (0x605E, 0): 2,
        (0x6060, 0): 0,
        (0x6065, 0): round(math.radians(10) * COUNT),
        (0x6066, 0): 100,
        (0x6067, 0): round(math.radians(0.5) * COUNT),
        (0x6068, 0): 10,
        (0x606D, 0): round(0.02 * TOP * COUNT),
        (0x6079, 0): 48_000,
        (0x607A, 0): 0,
        (0x607C, 0): 0,
        (0x607D, 0): 2,
        (0x607D, 1): round(-LIMIT * COUNT),
        (0x607D, 2): round(LIMIT * COUNT),
        (0x607F, 0): round(TOP * COUNT),
        (0x6080, 0): round(TOP * 42 * 60 / math.tau),
        (0x6081, 0): round(TOP * COUNT),
        **{(index, 0): round(ACCELERATION * COUNT) for index in (0x6083, 0x6084, 0x6085)},
        (0x6098, 0): 37,
        (0x6099, 0): 2,
        (0x6099, 1): round(0.25 * TOP * COUNT),
        (0x6099, 2): round(0.05 * TOP * COUNT),
        (0x609A, 0): round(ACCELERATION * COUNT),
        (0x608F, 0): 2,
        (0x608F, 1): 4096,
        (0x608F, 2): 1,
        (0x60C2, 0): 2,
        (0x60C2, 1): 20,
        (0x60C2, 2): -3,
        (0x60C5, 0): round(ACCELERATION * COUNT),
        (0x60FF, 0): 0,
        # Profile position and velocity, homing, cyclic position and velocity.
        (0x6502, 0): 0b1_1010_0101,
    }
    values = {key: drive.get(*key) for key in expected}
    values[0x606D, 0] &= 0xFFFF
    assert values == expected
    lengths = {
        drive_object: len(drive.master.read(NODE, *drive_object)) for drive_object in expected
    }
    assert {key for key, length in lengths.items() if length == 1} == {
        *((0x6060, 0), (0x6098, 0), (0x60C2, 1), (0x60C2, 2)),
        *((index, 0) for index in (0x607D, 0x6099, 0x608F, 0x60C2)),
    }
    assert {key for key, length in lengths.items() if length == 2} == {
        (index, 0) for index in (0x6007, 0x605A, 0x605C, 0x605E, 0x6066, 0x6068, 0x606D)
    }


def test_settings_are_stored_and_commands_are_not() -> None:
    names = {n for n in Drive().device.objects.parameters() if n.startswith("60")}
    assert names == {
        *("6007.00", "605a.00", "605c.00", "605e.00", "6060.00", "6065.00", "6066.00", "6067.00"),
        *("6068.00", "606d.00", "607c.00", "607d.01", "607d.02", "607f.00", "6080.00", "6081.00"),
        *("6083.00", "6084.00", "6085.00", "608f.01", "608f.02", "6098.00", "6099.01", "6099.02"),
        *("609a.00", "60c2.01", "60c2.02", "60c5.00"),
    }


@pytest.mark.parametrize(
    ("index", "subindex", "size", "lowest", "highest"),
    [
        (0x6007, 0, 2, 0, 3),
        (0x605A, 0, 2, 0, 6),
        (0x605C, 0, 2, 0, 1),
        (0x605E, 0, 2, 0, 2),
        (0x6083, 0, 4, 1, None),
        (0x60C5, 0, 4, 1, None),
        (0x6099, 1, 4, 1, None),
        (0x60C2, 1, 1, 1, None),
        (0x60C2, 2, 1, -6, 0),
    ],
)
def test_ranges_of_objects(
    index: int, subindex: int, size: int, lowest: int, highest: int | None
) -> None:
    drive = Drive()
    drive.set(index, lowest, size, subindex)
    for value in (lowest - 1, *(() if highest is None else (highest + 1,))):
        if value >= 0 or size != 4:
            with pytest.raises(Refused, match="0x06090030"):
                drive.set(index, value, size, subindex)
    if highest is not None:
        drive.set(index, highest, size, subindex)


# -- states -------------------------------------------------------------------------------


def test_the_sequence_to_operation_enabled() -> None:
    drive = Drive()
    states = [drive.state]
    for word in (SWITCH_ON, SHUTDOWN, SWITCH_ON, ENABLE, SWITCH_ON, SHUTDOWN, ENABLE, DISABLE):
        drive.control(word)
        drive.sleep(0.01)
        states.append(drive.state)
    assert states == [
        "switch on disabled",
        "switch on disabled",  # this word is not allowed here
        "ready to switch on",
        "switched on",
        "operation enabled",
        "switched on",
        "ready to switch on",
        "operation enabled",  # two transitions in one, as newer editions of CiA 402 allow
        "switch on disabled",
    ]


def test_quick_stop_ramps_and_switches_off() -> None:
    drive = Drive()
    drive.enable(3)
    drive.set(0x60FF, 2.0 * COUNT)
    drive.sleep(0.6)
    assert drive.joint[1] == pytest.approx(2.0, abs=1e-3)
    drive.set(0x6085, 4.0 * COUNT)
    drive.control(QUICK_STOP)
    drive.sleep(0.1)
    assert drive.state == "quick stop active"
    assert 1.2 < drive.joint[1] < 1.7
    drive.sleep(0.5)
    assert drive.joint[1] == 0.0
    assert drive.state == "switch on disabled"


def test_quick_stop_that_stays_enabled() -> None:
    drive = Drive()
    drive.set(0x605A, 6, 2)
    drive.enable(3)
    drive.set(0x60FF, COUNT)
    drive.sleep(0.3)
    drive.control(QUICK_STOP)
    drive.sleep(0.5)
    assert drive.state == "quick stop active"
    assert drive.joint[1] == 0.0
    drive.control(ENABLE)
    drive.sleep(0.3)
    assert drive.state == "operation enabled"
    assert drive.joint[1] == pytest.approx(1.0, abs=1e-3)


def test_nothing_moves_while_it_is_not_enabled() -> None:
    drive = Drive()
    drive.set(0x6060, 3, 1)
    drive.set(0x60FF, COUNT)
    drive.control(SHUTDOWN, SWITCH_ON)
    drive.sleep(0.5)
    assert drive.joint == (0.0, 0.0)
    drive.control(ENABLE)
    drive.sleep(0.5)
    drive.control(DISABLE)
    drive.sleep(1.0)
    assert drive.joint[1] == 0.0


@pytest.mark.parametrize(
    ("option", "state", "speed"),
    [
        (0, "operation enabled", 1.0),
        (1, "fault", 0.0),
        (2, "switch on disabled", 0.0),
        (3, "switch on disabled", 0.0),
    ],
)
def test_reaction_to_a_lost_master(option: int, state: str, speed: float) -> None:
    """Object 0x6007 defines the reaction to a missing heartbeat of the master (0x1016)."""
    drive = Drive()
    drive.set(0x6007, option, 2)
    drive.set(0x1029, 1, 1, subindex=1)
    drive.set(0x1016, 127 << 16 | 200, subindex=1)
    drive.enable(3)
    drive.set(0x60FF, COUNT)
    for _ in range(5):
        drive.master.send(0x77F, b"\5")
        drive.sleep(0.1)
    assert drive.joint[1] == pytest.approx(1.0, abs=1e-3)
    drive.sleep(0.7)
    assert drive.state == state
    assert drive.joint[1] == pytest.approx(speed, abs=1e-3)


def test_a_fault_reset_needs_a_rising_edge() -> None:
    drive = Drive()
    drive.enable(3)
    drive.axis.fail(0x2310)
    drive.sleep(0.05)
    assert drive.state == "fault"
    assert drive.master.number(NODE, 0x603F) == 0x2310
    drive.control(ENABLE)
    assert drive.state == "fault"
    drive.control(RESET)
    assert drive.state == "switch on disabled"
    assert drive.master.number(NODE, 0x603F) == 0
    drive.axis.fail(0x2310)
    drive.control(RESET)
    assert drive.state == "fault", "the bit was high already"
    drive.control(0, RESET)
    assert drive.state == "switch on disabled"


def test_leaving_operational_stops_it() -> None:
    drive = Drive()
    drive.set(0x6007, 3, 2)
    drive.enable(3)
    drive.set(0x60FF, COUNT)
    drive.sleep(0.5)
    drive.master.nmt(128)
    drive.sleep(0.5)
    assert drive.joint[1] == 0.0
    assert drive.state == "switch on disabled"


# -- modes --------------------------------------------------------------------------------


def test_profile_velocity_ramps_by_its_accelerations() -> None:
    drive = Drive()
    drive.set(0x6083, 2.0 * COUNT)
    drive.set(0x6084, 4.0 * COUNT)
    drive.enable(3)
    drive.set(0x60FF, 1.0 * COUNT)
    drive.sleep(0.25)
    assert drive.joint[1] == pytest.approx(0.5, abs=0.02)
    assert not drive.word & 1 << 10
    drive.sleep(0.4)
    assert drive.joint[1] == pytest.approx(1.0, abs=1e-3)
    assert drive.word & 1 << 10, "target reached"
    assert drive.get(0x606C) == pytest.approx(COUNT, abs=1)
    drive.set(0x60FF, 0)
    drive.sleep(0.125)
    assert drive.joint[1] == pytest.approx(0.5, abs=0.03)
    drive.sleep(0.2)
    assert drive.word & 1 << 12, "speed is zero"


def test_speed_is_limited_and_the_status_word_reports_it() -> None:
    drive = Drive()
    drive.set(0x607F, 0.5 * COUNT)
    drive.enable(3)
    drive.set(0x60FF, COUNT)
    drive.sleep(0.5)
    assert drive.joint[1] == pytest.approx(0.5, abs=0.01)
    assert drive.word & 1 << 11


def test_software_limits_end_a_motion() -> None:
    drive = Drive()
    drive.enable(3)
    drive.set(0x60FF, 3.0 * COUNT)
    drive.sleep(4.0)
    assert drive.joint[0] == pytest.approx(LIMIT, abs=0.02)
    assert drive.joint[1] == pytest.approx(0.0, abs=0.01)
    assert drive.word & 1 << 11
    drive.set(0x60FF, -1.0 * COUNT)
    drive.sleep(0.5)
    assert drive.joint[1] == pytest.approx(-1.0, abs=0.01), "back is allowed"


def test_without_limits_the_mechanical_stop_causes_a_fault() -> None:
    drive = Drive(lower=None, upper=None)
    drive.enable(3)
    drive.set(0x60FF, 2.0 * COUNT)
    drive.sleep(3.0)
    assert drive.joint == (STOP, 0.0)
    assert drive.state == "fault"


def test_profile_position_moves_and_arrives() -> None:
    drive = Drive()
    drive.set(0x6081, 1.0 * COUNT)
    drive.enable(1)
    drive.set(0x607A, 1.0 * COUNT)
    drive.control(ENABLE | 0x10)
    drive.sleep(0.005)
    assert drive.word & 1 << 12, "set-point acknowledged"
    drive.control(ENABLE)
    assert not drive.word & 1 << 12
    drive.sleep(0.5)
    assert 0.3 < drive.joint[0] < 0.6
    assert not drive.word & 1 << 10
    drive.sleep(0.8)
    assert drive.joint[0] == pytest.approx(1.0, abs=1e-4)
    assert drive.word & 1 << 10
    assert drive.get(0x6064) == pytest.approx(COUNT, abs=1)


def test_profile_position_in_sequence_and_immediately() -> None:
    drive = Drive()
    drive.set(0x6081, 2.0 * COUNT)
    drive.enable(1)
    for target in (0.5, 1.0):
        drive.set(0x607A, target * COUNT)
        drive.control(ENABLE | 0x10)
        drive.control(ENABLE)
    drive.sleep(1.5)
    assert drive.joint[0] == pytest.approx(1.0, abs=1e-3), "one after the other"
    drive.set(0x607A, -2.0 * COUNT)
    drive.control(ENABLE | 0x10)
    drive.control(ENABLE)
    drive.sleep(0.2)
    drive.set(0x607A, 0.5 * COUNT)
    drive.control(ENABLE | 0x30)
    drive.sleep(1.2)
    assert drive.joint[0] == pytest.approx(0.5, abs=1e-3), "immediately, from the present position"
    drive.control(ENABLE)
    drive.control(ENABLE | 0x50)
    drive.sleep(1.2)
    assert drive.joint[0] == pytest.approx(1.0, abs=1e-3), "relative to the previous target"


def test_profile_position_halts_and_continues() -> None:
    drive = Drive()
    drive.set(0x6081, 1.0 * COUNT)
    drive.enable(1)
    drive.set(0x607A, 2.0 * COUNT)
    drive.control(ENABLE | 0x10)
    drive.sleep(0.5)
    drive.control(ENABLE | 0x110)
    drive.sleep(0.5)
    halted = drive.joint[0]
    assert drive.joint[1] == 0.0
    assert halted < 1.0
    drive.control(ENABLE | 0x10)
    drive.sleep(3.0)
    assert drive.joint[0] == pytest.approx(2.0, abs=1e-3)


def test_a_target_beyond_the_limit_ends_at_it() -> None:
    drive = Drive()
    drive.enable(1)
    drive.set(0x607A, 5.0 * COUNT)
    drive.control(ENABLE | 0x10)
    drive.sleep(3.0)
    assert drive.joint[0] == pytest.approx(LIMIT, abs=1e-3)
    assert drive.word & 1 << 11


def cyclic(drive: Drive, targets: list[float]) -> list[tuple[int, int]]:
    """Runs one control cycle per target (RPDO, SYNC); returns the reported status and position."""
    reports = []
    for target in targets:
        drive.master.send(0x20A, struct.pack("<Hi", ENABLE, round(target * COUNT)))
        drive.master.send(0x080, b"")
        answer = drive.master.wait(0x18A, 0.01)
        if answer is not None:
            reports.append(struct.unpack("<Hi", answer))
        drive.sleep(0.02 - 0.0008)
    return reports


def test_cyclic_position_follows_between_the_targets() -> None:
    drive = Drive()
    drive.enable(8)
    reports = cyclic(drive, [0.02 * k for k in range(50)])
    assert len(reports) == 50, "a report for each SYNC"
    positions = [p / COUNT for _, p in reports]
    assert positions[-1] == pytest.approx(0.94, abs=0.03), "two cycles behind"
    steps = [b - a for a, b in itertools.pairwise(positions[5:])]
    assert all(0.015 < step < 0.025 for step in steps), steps
    assert not reports[-1][0] & 1 << 13


def test_a_blocked_motor_is_a_following_error() -> None:
    drive = Drive()
    drive.set(0x6065, 0.1 * COUNT)
    drive.set(0x6066, 50, 2)
    drive.enable(8)
    cyclic(drive, [0.0] * 3)
    drive.motor.blocked = True
    cyclic(drive, [0.02 * k for k in range(1, 6)])
    assert drive.state == "operation enabled"
    cyclic(drive, [0.1 + 0.02 * k for k in range(1, 6)])
    drive.sleep(0.2)
    assert drive.state == "fault"
    assert drive.master.number(NODE, 0x603F) == 0x8611


def test_no_window_no_following_error() -> None:
    drive = Drive()
    drive.set(0x6065, 0xFFFFFFFF)
    drive.enable(8)
    drive.motor.blocked = True
    cyclic(drive, [0.05 * k for k in range(20)])
    assert drive.state == "operation enabled"


@pytest.mark.parametrize("what", ["blocked", "frozen"])
def test_a_speed_that_is_not_reached_is_a_fault(what: str) -> None:
    drive = Drive()
    drive.enable(9)
    if what == "blocked":
        drive.motor.blocked = True
    else:
        drive.axis.encoder.frozen = True
    drive.set(0x60FF, 1.0 * COUNT)
    drive.sleep(0.7)
    assert drive.state == "fault"
    assert drive.master.number(NODE, 0x603F) == 0x8400
    drive.sleep(0.5)
    assert drive.joint[1] == 0.0


@pytest.mark.parametrize(("mode", "shown"), [(1, True), (3, False), (8, True), (9, False)])
def test_only_modes_of_the_position_report_a_following_error(mode: int, shown: bool) -> None:
    drive = Drive()
    drive.set(0x6065, 0.1 * COUNT)
    drive.set(0x6066, 10_000, 2)
    drive.enable(mode)
    assert not drive.word & 1 << 13
    drive.motor.blocked = True
    drive.set(0x607A, 2.0 * COUNT)
    drive.set(0x60FF, 2.0 * COUNT)
    drive.control(ENABLE | 0x10)
    for _ in range(10):
        drive.master.send(0x080, b"")
        drive.sleep(0.03)
    assert drive.state == "operation enabled"
    assert bool(drive.word & 1 << 13) is shown


def test_cyclic_velocity_needs_no_sync_by_an_event_driven_pdo() -> None:
    drive = Drive()
    drive.enable(9)
    drive.master.send(0x30A, struct.pack("<Hi", ENABLE, round(COUNT)))
    drive.sleep(0.3)
    assert drive.joint[1] == pytest.approx(1.0, abs=0.01)


def test_the_brake_opens_before_the_motor_moves() -> None:
    plain, braked = Drive(), Drive(brake=True)
    for drive in (plain, braked):
        drive.set(0x6060, 9, 1)
        drive.set(0x60FF, COUNT)
        drive.control(SHUTDOWN, SWITCH_ON, ENABLE)
        drive.sleep(0.015)
    assert plain.joint[0] > 0.0
    assert braked.joint[0] == 0.0
    braked.sleep(0.05)
    assert braked.joint[0] > 0.0


# -- homing -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "home"), [(17, -LIMIT), (18, LIMIT), (-1, -STOP), (-2, STOP), (37, 0.7)]
)
def test_homing_finds_zero(method: int, home: float) -> None:
    """The drive starts at any position; after homing it counts from home position plus offset."""
    drive = Drive(position=0.7)
    assert drive.get(0x6064) == 0
    drive.set(0x6098, method & 0xFF, 1)
    drive.set(0x607C, -home * COUNT)
    drive.enable(6)
    drive.control(ENABLE | 0x10)
    drive.sleep(12.0)
    assert drive.word & 1 << 12, "attained"
    assert not drive.word & 1 << 13
    joint, speed = drive.joint
    assert speed == 0.0
    assert joint == pytest.approx(home, abs=0.02)
    assert drive.get(0x6064) / COUNT == pytest.approx(joint, abs=0.01)


def test_an_unsupported_homing_method_is_an_error() -> None:
    drive = Drive()
    drive.set(0x6098, 5, 1)
    drive.enable(6)
    drive.control(ENABLE | 0x10)
    drive.sleep(0.1)
    assert drive.word & 1 << 13
    assert drive.joint == (0.0, 0.0)


def test_a_loss_of_power_loses_the_home_position() -> None:
    drive = Drive(position=0.7)
    drive.set(0x6098, 37, 1)
    drive.enable(6)
    drive.control(ENABLE | 0x10)
    drive.sleep(0.1)
    assert drive.word & 1 << 12
    drive.device.power_off()
    drive.device.power_on()
    drive.sleep(0.2)
    assert not drive.word & 1 << 12
