"""The Thorvald's motor controller, by the bytes of its published frames."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from types import SimpleNamespace
from typing import NamedTuple

import pytest

from tests.simulation.bus.master import Master, Refused
from tests.simulation.bus.specifications import specification
from thorvaldc.model import Channel
from thorvaldc.simulation.bus.roboteq_device import RoboteqController
from thorvaldc.simulation.bus.simulated_motors import IdealMotor
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire

N = 3
GEAR, STEERING_GEAR, PPR, STEERING_PPR, LIMIT = 42.0, 42.8571429, 1024, 4096, 3.078027759
MAX_RPM = 3000.0
TOP = MAX_RPM * math.pi / 30 / GEAR
DRIVE, HOME, DECOUPLED = 0, 1, 2


class Motor(NamedTuple):
    """What the controller takes from an actuator of the model, and from its joint."""

    name: str
    role: str
    gear_ratio: float
    encoder_ppr: int
    encoder_offset: float
    motor_max_speed: float = MAX_RPM * math.pi / 30.0

    @property
    def joint(self) -> Motor:
        return self

    @property
    def upper(self) -> float | None:
        return LIMIT if self.role == "steering" else None

    lower = upper


def motor(name: str, gear_ratio: float, encoder_ppr: int, home_angle: float = 0.0) -> Motor:
    role = "steering" if name == "steering" else "propulsion"
    return Motor(name, role, gear_ratio, encoder_ppr, home_angle)


def controller(
    wire: Wire,
    motors: dict[Motor, IdealMotor],
    nonvolatile: Mapping[str, int] | None = None,
    **properties: object,
) -> RoboteqController:
    robot = SimpleNamespace(actuators=list(motors), joint=lambda joint: joint)
    return RoboteqController(
        specification(
            wire,
            N,
            name="fl",
            heartbeat=0.1,
            nonvolatile=nonvolatile,
            robot=robot,
            motor=motors.get,
            channels=tuple(Channel(own.name, own.role, own.name) for own in motors),
            properties=tuple(properties.items()),
            vendor_id=0x469,
            product_code=0x2360,
            revision_number=0x20,
        )
    )


class Controller:
    """A controller with its motors; the steering is at ``angle`` (rad) at power-on."""

    def __init__(
        self,
        angle: float = 0.0,
        operational: bool = True,
        home_angle: float = 0.0,
        nonvolatile: Mapping[str, int] | None = None,
    ) -> None:
        self.wire = Wire(Timeline())
        self.master = Master(VirtualTimeInterface(self.wire, "master"))
        self.propulsion = IdealMotor(TOP, 7.5, 113.0)
        self.steering = IdealMotor(4.0, 20.0, 50.0, -math.pi, math.pi, position=angle)
        steering = motor("steering", STEERING_GEAR, STEERING_PPR, home_angle)
        self.device = controller(
            self.wire,
            {motor("propulsion", GEAR, PPR): self.propulsion, steering: self.steering},
            nonvolatile,
            script_version="2.7.1",
            script_type=4,
        )
        self.sequence = 0
        self.device.power_on()
        self.master.interface.sleep(0.2)
        if operational:
            self.master.nmt(1)
            self.master.interface.sleep(0.02)

    def drive(self, seconds: float, speed: int = 0, position: int | None = None) -> None:
        """Sends commands at 50 Hz, as the base driver does."""
        for _ in range(round(seconds / 0.02)):
            self.sequence += 1
            self.master.send(0x200 + N, struct.pack("<ii", self.sequence, speed))
            if position is not None:
                self.master.send(0x500 + N, struct.pack("<ii", 0, position))
            self.master.interface.sleep(0.02)

    def latest(self, base: int) -> bytes:
        """Returns the newest frame of a report."""
        self.master.interface.received.clear()
        data = self.master.wait(base + N, 2.0)
        assert data is not None
        return data

    @property
    def flags(self) -> int:
        return self.latest(0x380)[0]

    def angle(self) -> float:
        return self.steering.read(self.wire.timeline.seconds).position


def test_speed_is_a_thousandth_of_the_limit() -> None:
    c = Controller()
    c.drive(1.5, 500)
    rpm, _, _ = struct.unpack("<hhi", c.latest(0x180))
    assert rpm == 1500
    speed = c.propulsion.read(c.wire.timeline.seconds).velocity
    assert speed == pytest.approx(1500 / GEAR * math.pi / 30)


def test_position_is_a_thousandth_of_the_steering_limit() -> None:
    c = Controller()
    c.drive(1.0, 0, -250)
    assert c.angle() == pytest.approx(-LIMIT / 4, abs=1e-3)
    _, _, counts = struct.unpack("<hhi", c.latest(0x180))
    angle = counts * 2 * math.pi / (4 * STEERING_PPR * STEERING_GEAR)
    assert angle == pytest.approx(-LIMIT / 4, abs=1e-3)


def test_the_steering_obeys_the_speed_limit_of_the_command() -> None:
    c = Controller()
    rpm = 300
    for _ in range(50):
        c.master.send(0x500 + N, struct.pack("<ii", rpm, 1000))
        c.master.interface.sleep(0.02)
    _, speed, _ = struct.unpack("<hhi", c.latest(0x180))
    assert speed == pytest.approx(rpm, abs=1)
    assert c.angle() == pytest.approx(rpm * math.pi / 30 / STEERING_GEAR, abs=0.06)


def test_no_command_counts_before_the_node_is_operational() -> None:
    c = Controller(operational=False)
    c.drive(0.5, 500, 500)
    assert c.propulsion.read(c.wire.timeline.seconds).velocity == 0.0
    assert c.angle() == 0.0
    reports = (0x180, 0x280, 0x380, 0x480)
    assert not any(r.frame.id - N in reports for r in c.master.interface.received)


def test_stale_commands_stop_the_propulsion() -> None:
    """A repeated sequence number is not a new command."""
    c = Controller()
    c.drive(1.0, 500)
    for _ in range(100):
        c.master.send(0x200 + N, struct.pack("<ii", c.sequence, 500))
        c.master.interface.sleep(0.02)
    assert c.propulsion.read(c.wire.timeline.seconds).velocity == 0.0
    c.drive(1.0, 500)
    assert c.propulsion.read(c.wire.timeline.seconds).velocity > 3.0


def test_reports_have_cycles_that_can_be_set() -> None:
    c = Controller()

    def rates(seconds: float) -> list[int]:
        c.master.interface.received.clear()
        c.master.interface.sleep(seconds)
        bases = [r.frame.id - N for r in c.master.interface.received]
        return [bases.count(base) for base in (0x180, 0x280, 0x380, 0x480)]

    assert rates(2.0) == [100, 20, 20, 2]
    c.master.send(0x300 + N, struct.pack("<ii", 8, 50))
    c.master.send(0x300 + N, struct.pack("<ii", 11, 0))
    c.master.interface.sleep(1.1)
    assert rates(2.0) == [40, 20, 20, 0]


def test_tpdo4_sends_the_constants_in_turn() -> None:
    c = Controller()
    frames = [c.latest(0x480) for _ in range(3)]
    by_content = {frame[3]: frame for frame in frames}
    assert sorted(by_content) == [1, 2, 3]
    version = by_content[2]
    assert version[4] == 4
    assert (version[7], version[6], version[5]) == (2, 7, 1), "b7.b6.b5"
    assert struct.unpack_from("<HH", by_content[3], 4) == (PPR, STEERING_PPR)


def test_supply_and_temperature() -> None:
    c = Controller()
    frame = c.latest(0x380)
    assert struct.unpack_from("<h", frame, 2)[0] == 25
    assert struct.unpack_from("<h", frame, 6)[0] == 480
    c.drive(0.3, 1000)
    amps, _, power, _ = struct.unpack("<hhhh", c.latest(0x280))
    assert power > 100
    assert amps == pytest.approx(10 * power / 48, abs=1)


def test_settings_1_to_3_are_stored_and_the_others_are_not() -> None:
    c = Controller()
    for setup, value in ((1, 1), (3, 700), (4, 600)):
        c.master.send(0x300 + N, struct.pack("<ii", setup, value))
        c.master.interface.sleep(0.05)
    c.drive(1.5, 1000)
    speed = c.propulsion.read(c.wire.timeline.seconds).velocity
    assert speed == pytest.approx(-600 * math.pi / 30 / GEAR), "reversed, and at most 600 rpm"
    c.device.power_off()
    c.master.interface.sleep(2.0)
    c.device.power_on()
    c.master.interface.sleep(0.2)
    c.master.nmt(1)
    c.drive(3.0, 1000)
    assert c.propulsion.read(c.wire.timeline.seconds).velocity == pytest.approx(-TOP)
    assert c.device.nonvolatile["home_speed"] == 700


@pytest.mark.parametrize(
    ("base", "first", "second"),
    [
        (0x200, 1, 1001),
        (0x300, 99, 0),
        (0x300, 0, 0),
        (0x400, 3, 0),
        (0x500, 0, -1001),
    ],
)
def test_an_illegal_command_is_flagged_and_ignored(base: int, first: int, second: int) -> None:
    c = Controller()
    assert c.flags == 0
    c.master.send(base + N, struct.pack("<ii", first, second))
    c.master.interface.sleep(0.02)
    assert c.flags == 0x02
    c.drive(0.1)
    assert c.flags == 0
    assert c.angle() == 0.0


@pytest.mark.parametrize("angle", [2.0, -2.0, 0.3])
def test_homing_finds_the_switch_and_counts_from_straight_ahead(angle: float) -> None:
    """After power-on it counts from the present angle; after homing, 0 is straight ahead."""
    c = Controller(angle=angle)
    assert struct.unpack("<hhi", c.latest(0x180))[2] == 0
    c.drive(0.5, 0, 200)
    assert c.angle() == pytest.approx(angle + 0.2 * LIMIT, abs=1e-2)
    assert not c.device.homed
    c.master.send(0x400 + N, struct.pack("<ii", DRIVE, HOME))
    c.drive(12.0)
    configurations = [f for f in (c.latest(0x480) for _ in range(3)) if f[3] == 1]
    assert configurations[0][4] == 0x01, "homed, and no longer homing"
    assert c.angle() == pytest.approx(0.0, abs=1e-3)
    c.drive(1.0, 0, 100)
    assert c.angle() == pytest.approx(0.1 * LIMIT, abs=1e-2)
    assert c.flags == 0


def test_the_home_count_is_the_count_at_the_switch() -> None:
    per_radian = 4 * STEERING_PPR * STEERING_GEAR / math.tau
    c = Controller(
        angle=-1.0, home_angle=0.25, nonvolatile={"home_count": round(0.25 * per_radian)}
    )
    c.master.send(0x400 + N, struct.pack("<ii", DRIVE, HOME))
    c.drive(8.0)
    assert c.angle() == pytest.approx(0.0, abs=1e-2)
    _, _, counts = struct.unpack("<hhi", c.latest(0x180))
    assert counts == pytest.approx(0, abs=per_radian * 1e-2)


def test_homing_without_a_switch_ends() -> None:
    c = Controller(angle=1.0)
    c.device.home_switch_works = False
    c.master.send(0x400 + N, struct.pack("<ii", DRIVE, HOME))
    c.drive(12.0)
    assert c.flags & 0x04, "homing at maximum count"
    assert c.flags & 0x01
    assert not c.device.homed


def test_decoupled_motors_are_free() -> None:
    c = Controller()
    c.drive(1.0, 500)
    c.master.send(0x400 + N, struct.pack("<ii", DECOUPLED, DRIVE))
    c.drive(1.0, 500)
    assert c.propulsion.read(c.wire.timeline.seconds).velocity == 0.0
    c.master.send(0x400 + N, struct.pack("<ii", DRIVE, DRIVE))
    c.drive(0.02)
    c.drive(1.0, 500)
    assert c.propulsion.read(c.wire.timeline.seconds).velocity > 3.0


def test_a_blocked_wheel_is_a_stall_and_a_frozen_encoder_an_encoder_error() -> None:
    for blocked, flags, code in ((True, 0x19, 0x7121), (False, 0x99, 0x7305)):
        c = Controller()
        if blocked:
            c.propulsion.blocked = True
        else:
            c.device.channels[0].encoder.frozen = True
        c.drive(1.5, 500)
        emergencies = [r.frame.data for r in c.master.interface.received if r.frame.id == 0x080 + N]
        assert [struct.unpack_from("<H", data)[0] for data in emergencies] == [code]
        assert c.flags == flags
        assert c.propulsion.read(c.wire.timeline.seconds).velocity == 0.0


def test_it_has_neither_lss_nor_a_serial_number() -> None:
    c = Controller()
    assert c.master.number(N, 0x1018, 1) == 0x469
    with pytest.raises(Refused):
        c.master.read(N, 0x1018, 4)
    c.master.lss(0x04, 1)
    assert c.master.lss(0x5E) is None


def test_the_makers_tool_sets_its_id() -> None:
    c = Controller()
    c.device.change_node_id(7)
    c.master.interface.sleep(0.2)
    assert c.master.number(7, 0x1018, 1) == 0x469
    c.device.power_off()
    c.device.power_on()
    c.master.interface.sleep(0.2)
    assert c.master.number(7, 0x1018, 1) == 0x469


def test_two_propulsion_motors_on_one_controller() -> None:
    wire = Wire(Timeline())
    master = Master(VirtualTimeInterface(wire, "master"))
    left, right = (IdealMotor(TOP, 7.5) for _ in range(2))
    device = controller(
        wire, {motor(name, GEAR, PPR): own for name, own in (("left", left), ("right", right))}
    )
    device.power_on()
    master.interface.sleep(0.2)
    master.nmt(1)
    for k in range(100):
        master.send(0x200 + N, struct.pack("<ii", k, 100))
        master.send(0x500 + N, struct.pack("<ii", 0, -200))
        master.interface.sleep(0.02)
    assert struct.unpack("<hhi", master.all(0x180 + N, 0.05)[-1]) == (300, -600, 0)
    master.send(0x400 + N, struct.pack("<ii", HOME, DRIVE))
    master.interface.sleep(0.01)
    assert device.illegal_command
