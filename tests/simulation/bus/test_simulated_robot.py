"""The whole bus of a robot, made from its model alone: the traffic matches the CAN map."""

from __future__ import annotations

import itertools
import math
import struct
from typing import Any

import cantools
import pytest

from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.robots import make_robot
from tests.simulation.bus.master import Master
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.model.bus import OBJECT_TYPES
from thorvaldc.model.model_json import from_json, to_json
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.physics.sim_base import SimBase

ENABLE = 0x0F


class Bus:
    """A powered robot and a master; ``seen`` has time (s) and data of all frames by identifier."""

    def __init__(self, robot: Robot, **options: Any) -> None:
        self.robot = robot
        self.simulated = SimulatedRobot(robot, **options)
        self.master = Master(self.simulated.interface(receive_limit=100_000))
        self.seen: dict[int, list[tuple[float, bytes]]] = {}
        self.simulated.wire().observers.append(
            lambda time, frame, _: self.seen.setdefault(frame.id, []).append(
                (time / 1e9, frame.data)
            )
        )
        self.simulated.power_on()
        self.simulated.run(0.3)

    def database(self) -> Any:
        files = emit(self.robot, ["can"], Report())
        return cantools.database.load_string(files["can/robot.dbc"].decode("cp1252"), "dbc")


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_the_traffic_matches_the_can_map(name: str) -> None:
    bus = Bus(example_robot(name))
    frames = {frame.cob_id: frame for frame in bus.robot.buses[0].frames}
    if 0x000 in frames:  # a robot without CANopen has no NMT
        bus.master.nmt(1)
    for _ in range(160):
        if 0x080 in frames:  # drives after CiA 402 send their synchronous PDOs after SYNC
            bus.master.send(0x080, b"")
        bus.simulated.run(0.02)
    assert set(bus.seen) <= set(frames)
    for frame in frames.values():
        if frame.producer == "master" or frame.period is None:
            continue
        times = [time for time, _ in bus.seen[frame.cob_id] if time > 0.5]
        assert {len(data) for _, data in bus.seen[frame.cob_id]} == {frame.length}, frame.name
        steps = [b - a for a, b in itertools.pairwise(times)]
        mean = sum(steps) / len(steps)
        assert mean == pytest.approx(frame.period, abs=2e-3), frame.name
        # The lowest priority may wait, but at most for the response time in the map.
        assert max(steps) <= frame.period + (frame.response_time or 0.0), frame.name


def test_the_model_file_is_sufficient() -> None:
    whole, alone = (Bus(robot) for robot in (cia402_robot(), from_json(to_json(cia402_robot()))))
    for bus in (whole, alone):
        bus.simulated.run(1.0)
    assert whole.seen == alone.seen


def test_the_seed_determines_the_traffic() -> None:
    first, same, another_seed = (Bus(cia402_robot(), seed=seed) for seed in (1, 1, 2))
    assert first.seen == same.seen
    assert first.seen != another_seed.seen


def test_cantools_decodes_the_frames_with_our_dbc() -> None:
    """The state of the joints equals the reports that cantools decodes."""
    bus = Bus(example_robot("4wd4ws_wide"))
    database = bus.database()
    node = bus.robot.buses[0].nodes[0]
    wheel = {a.name: a for a in bus.robot.actuators}
    speed, angle = 1.5, -0.6
    bus.master.nmt(1)
    rpdo1 = database.get_message_by_name(f"{node.name}_rpdo1")
    rpdo4 = database.get_message_by_name(f"{node.name}_rpdo4")
    for k in range(100):
        for message, values in (
            (rpdo1, {"sequence": k, "speed": speed}),
            (rpdo4, {"steering_max_speed": 0.0, "position": angle}),
        ):
            bus.master.send(message.frame_id, message.encode(values))
        bus.simulated.run(0.02)
    raw = next(x for x in rpdo1.signals if x.name == "speed").scale
    propulsion, steering = (
        bus.simulated.motors[c.actuator].read(bus.simulated.timeline.seconds)
        for c in node.channels
        if c.actuator is not None
    )
    assert propulsion.velocity == pytest.approx(speed, abs=raw)
    assert steering.position == pytest.approx(angle, abs=2e-3)
    tpdo1 = database.get_message_by_name(f"{node.name}_tpdo1")
    decoded = tpdo1.decode(bus.seen[tpdo1.frame_id][-1][1])
    gear = wheel[node.channels[0].actuator or ""].gear_ratio
    rpm = math.pi / 30 / gear
    assert decoded["propulsion_velocity"] == pytest.approx(propulsion.velocity, abs=rpm)
    assert decoded["steering_position"] == pytest.approx(steering.position, abs=1e-4)
    tpdo3 = database.get_message_by_name(f"{node.name}_tpdo3")
    decoded = tpdo3.decode(bus.seen[tpdo3.frame_id][-1][1])
    assert decoded["supply_voltage"] == 48.0
    assert decoded["temperature"] == 25
    assert not decoded["controller_not_ok"]
    battery = next(n for n in bus.robot.buses[0].nodes if n.id_space == "kc_battery")
    status = database.get_message_by_name(f"{battery.name}_status")
    decoded = status.decode(bus.seen[status.frame_id][-1][1])
    assert decoded["voltage"] == pytest.approx(48.0)
    assert decoded["discharge_enabled"] == 1
    charge = database.get_message_by_name(f"{battery.name}_charge")
    assert charge.decode(bus.seen[charge.frame_id][-1][1])["state_of_charge"] == 90


def test_cantools_and_the_cia402_drives() -> None:
    bus = Bus(cia402_robot())
    database = bus.database()
    bus.master.nmt(1)
    angle, speed = 0.5, 1.2
    for word in (6, 7, 15, *(31 for _ in range(60)), *(15 for _ in range(40))):
        for n in ("fl", "fr", "rl", "rr"):
            rpdo1 = database.get_message_by_name(f"{n}_controller_rpdo1")
            rpdo2 = database.get_message_by_name(f"{n}_controller_rpdo2")
            values = {
                "propulsion_controlword": word & 15,
                "propulsion_mode_of_operation": 3,
                "propulsion_target_velocity": speed,
            }
            bus.master.send(rpdo1.frame_id, rpdo1.encode(values))
            values = {
                "steering_controlword": word,
                "steering_mode_of_operation": 1,
                "steering_target_position": angle,
            }
            bus.master.send(rpdo2.frame_id, rpdo2.encode(values))
        bus.master.send(0x080, b"")
        bus.master.send(0x77F, b"\5")
        bus.simulated.run(0.02)
    now = bus.simulated.timeline.seconds
    for n in ("fl", "fr", "rl", "rr"):
        tpdo1 = database.get_message_by_name(f"{n}_controller_tpdo1")
        decoded = tpdo1.decode(bus.seen[tpdo1.frame_id][-1][1])
        assert decoded["propulsion_statusword"] & 0x6F == 0x27
        assert decoded["propulsion_velocity"] == pytest.approx(speed, rel=1e-3)
        tpdo2 = database.get_message_by_name(f"{n}_controller_tpdo2")
        decoded = tpdo2.decode(bus.seen[tpdo2.frame_id][-1][1])
        assert decoded["steering_position"] == pytest.approx(angle, abs=1e-3)
        wheel = next(
            a
            for a in bus.robot.actuators
            if a.node == f"{n}_controller" and a.channel == "propulsion"
        )
        assert bus.simulated.motors[wheel.name].read(now).velocity == pytest.approx(speed, rel=1e-3)
    tpdo3 = database.get_message_by_name("fl_controller_tpdo3")
    assert tpdo3.decode(bus.seen[tpdo3.frame_id][-1][1])["supply_voltage"] == 48.0


@pytest.mark.parametrize("robot", ["cia402", "2wd0ws_greenhouse", "4wd4ws_wide"])
def test_the_objects_of_the_map_can_be_written_and_read_back(robot: str) -> None:
    """A device in its factory state accepts every value of the map."""
    model = cia402_robot() if robot == "cia402" else example_robot(robot)
    nonvolatile = {"fl_controller": {"node_id": 1}} if robot == "cia402" else {}
    bus = Bus(model, delivered=True, nonvolatile=nonvolatile)
    for node in model.buses[0].nodes[:1]:
        assert not node.lss or bus.master.number(node.id, 0x1018, 4)
        pdos = sorted({o.index for o in node.objects if 0x1400 <= o.index < 0x1C00})
        for index in pdos:
            if index & 0x200 == 0:  # switched off while its mapping changes
                old = bus.master.number(node.id, index, 1)
                bus.master.write(node.id, index, 1, old | 1 << 31, 4)
                bus.master.write(node.id, index | 0x200, 0, 0, 1)
        counts = []
        for entry in node.objects:
            if entry.value is None:
                continue
            if entry.access == "ro":
                assert bus.master.number(node.id, entry.index, entry.subindex) == entry.value
                continue
            if 0x1600 <= entry.index < 0x1C00 and entry.index & 0x200 and entry.subindex == 0:
                counts.append(entry)
            elif not (
                0x1400 <= entry.index < 0x1C00 and not entry.index & 0x200 and entry.subindex == 1
            ):
                size = max(OBJECT_TYPES[entry.type][1] // 8, 1)
                bus.master.write(node.id, entry.index, entry.subindex, entry.value, size)
        for entry in counts:
            bus.master.write(node.id, entry.index, 0, entry.value or 0, 1)
        for entry in node.objects:
            if 0x1400 <= entry.index < 0x1C00 and entry.subindex == 1 and not entry.index & 0x200:
                bus.master.write(node.id, entry.index, 1, entry.value or 0, 4)
        for entry in node.objects:
            if entry.value is not None:
                signed = entry.type.startswith("integer")
                value = bus.master.number(node.id, entry.index, entry.subindex, signed)
                assert value == entry.value, entry.name


def test_delivered_devices_have_neither_id_nor_parameters() -> None:
    bus = Bus(cia402_robot(), delivered=True)
    bus.simulated.run(1.0)
    identifiers = sorted(bus.seen)
    assert identifiers == [0x1A0, 0x3C1, 0x3D1, 0x3E1, 0x728], "only devices with fixed ids"
    serials = {d.serial for d in bus.simulated.devices.values() if isinstance(d, CanopenDevice)}
    assert serials == {0x101, 0x102, 0x103, 0x104}


def test_a_foreign_device_answers_its_commands() -> None:
    bus = Bus(cia402_robot())
    bus.master.send(0x240, b"spray\1")
    assert bus.master.wait(0x1C0) == b"\1\0\0\0"
    assert bus.simulated.devices["sprayer"].commands[-1].data == b"spray\1"  # type: ignore[attr-defined]


def test_the_io_board_switches_and_reports() -> None:
    bus = Bus(cia402_robot())
    assert bus.master.wait(0x1A0) == bytes([1, 0b10, 0]), "relay 1 is on at the start"
    bus.master.send(0x220, bytes([1, 0b10101, 0]))
    bus.master.send(0x220, bytes([2, 0xFF, 0]))
    assert bus.master.all(0x1A0, 0.25)[-1] == bytes([1, 0b10101, 0]), "another message is ignored"


def test_a_clone_has_the_id_but_not_the_serial_number() -> None:
    bus = Bus(cia402_robot())
    bus.simulated.clone("fl_controller", "spare").power_on()
    bus.simulated.run(0.3)
    bus.master.interface.received.clear()
    bus.master.send(0x601, struct.pack("<BHB4x", 0x40, 0x1018, 4))
    assert len(set(bus.master.all(0x581, 0.02))) == 2
    with pytest.raises(KeyError):
        bus.simulated.clone("nobody", "spare")


def test_a_robot_without_a_bus_is_refused() -> None:
    with pytest.raises(DiagnosticError) as raised:
        SimulatedRobot(make_robot([(0.5, 0.0, "steered")]))
    assert raised.value.diagnostic.code.name == "bus-missing"


def test_motors_may_be_the_joints_of_a_base() -> None:
    """The same frames move the joints of a base, here an ideal one."""
    robot = example_robot("4wd4ws_wide")
    base = SimBase(robot)
    bus = Bus(robot, base=base)
    bus.master.nmt(1)
    for k in range(100):
        for node in range(1, 5):
            bus.master.send(0x200 + node, struct.pack("<ii", k, 300))
            bus.master.send(0x500 + node, struct.pack("<ii", 0, 100 * node))
        bus.simulated.run(0.02)
    states = base.read(bus.simulated.timeline.seconds)
    limit = next(j.upper for j in robot.joints if j.role == "steering") or 0.0
    angles = {}
    for i, wheel in enumerate(robot.wheels):
        actuator = robot.actuator_of(wheel.spin_joint)
        assert actuator is not None
        assert states.speeds[i] == pytest.approx(
            0.3 * actuator.motor_max_speed / actuator.gear_ratio, rel=1e-3
        )
        node = next(n for n in robot.buses[0].nodes if n.name == actuator.node)
        angles[node.id] = states.angles[i]
    assert angles == pytest.approx({n: 0.1 * n * limit for n in range(1, 5)}, abs=1e-3)
