"""Devices become buses; a diagnostic of a conflict names both devices."""

from __future__ import annotations

import dataclasses
import math

import pytest

from tests.devices import (
    BATTERY,
    CYCLE,
    DRIVE,
    LIMIT,
    MODULES,
    MOTORS,
    TWO_DRIVES,
    Bench,
    frame,
    line,
    signal,
    simple,
)
from thorvaldc.compiler.bus.assemble_buses import connect_actuators
from thorvaldc.compiler.bus.device_sections import BusSpec, Device
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report


@pytest.fixture
def bench() -> Bench:
    return Bench()


# -- what the modules say -------------------------------------------------------------


def test_drive_has_the_published_frames(bench: Bench) -> None:
    bench.drive(3)
    (bus,) = bench.build()
    assert not list(bench.report)
    assert {f.name: f.cob_id for f in bus.frames if f.name.startswith("d1")} == {
        "d1_rpdo1": 0x203,
        "d1_rpdo2": 0x303,
        "d1_rpdo3": 0x403,
        "d1_rpdo4": 0x503,
        "d1_tpdo1": 0x183,
        "d1_tpdo2": 0x283,
        "d1_tpdo3": 0x383,
        "d1_tpdo4": 0x483,
        "d1_sdo_request": 0x603,
        "d1_sdo_response": 0x583,
        "d1_heartbeat": 0x703,
        "d1_emcy": 0x083,
    }
    for f in bus.frames:
        ours = f.name in ("d1_rpdo1", "d1_rpdo2", "d1_rpdo3", "d1_rpdo4", "d1_sdo_request")
        if f.name.startswith("d1"):
            assert (f.producer, f.consumers) == (
                ("master", ("d1",)) if ours else ("d1", ("master",))
            )
    assert [f.name for f in bus.frames if f.period == CYCLE] == [
        "sync",
        "d1_rpdo1",
        "d1_rpdo4",
        "d1_tpdo1",
    ]
    (node,) = bus.nodes
    assert (node.id, node.vendor_id, node.protocol) == (3, 0x469, "thorvald_roboteq")
    assert (node.heartbeat_timeout, node.heartbeat_consumer_time) == (2.0, None)


def test_scalings_are_the_published_ones(bench: Bench) -> None:
    motors = [
        dataclasses.replace(MOTORS[0], gear_ratio=42.0, motor_max_speed=100 * math.pi),
        dataclasses.replace(MOTORS[1], gear_ratio=42.8571429, encoder_ppr=4096),
    ]
    bench.add(DRIVE, 1, {"propulsion": motors[0], "steering": motors[1]})
    (bus,) = bench.build()

    def reads(frame_name: str, name: str, raw: int) -> float:
        found = signal(bus, frame_name, name)
        return raw * found.scale + found.offset

    # a speed of 1000 is 3000 motor rpm; v = rpm / gear * pi / 30
    assert reads("d1_rpdo1", "speed", 1000) == pytest.approx(3000 / 42 * math.pi / 30)
    assert reads("d1_tpdo1", "propulsion_velocity", 3000) == pytest.approx(3000 / 42 * math.pi / 30)
    assert reads("d1_rpdo4", "position", -1000) == pytest.approx(-LIMIT)
    assert reads("d1_tpdo1", "steering_position", 4 * 4096) == pytest.approx(
        2 * math.pi / 42.8571429
    )
    assert reads("d1_tpdo2", "propulsion_current", 123) == pytest.approx(12.3)
    assert reads("d1_tpdo3", "supply_voltage", 482) == pytest.approx(48.2)
    assert signal(bus, "d1_rpdo1", "speed").joint == motors[0].joint
    assert signal(bus, "d1_rpdo4", "position").joint == motors[1].joint


def test_setup_ids_and_versions(bench: Bench) -> None:
    bench.drive(1)
    (bus,) = bench.build()
    choices = dict(signal(bus, "d1_rpdo2", "setup_id").choices)
    assert list(choices) == list(range(1, 12))
    assert (choices[2], choices[7], choices[11]) == (
        "home_count",
        "max_steering_acceleration",
        "tpdo4_cycle_time",
    )
    selector = signal(bus, "d1_tpdo4", "content")
    assert (selector.start, selector.multiplexer) == (24, True)
    version = {s.name: s.start for s in frame(bus, "d1_tpdo4").signals if s.selected_by == (2,)}
    assert version == {
        "controller_type": 32,
        "version_patch": 40,
        "version_minor": 48,
        "version_major": 56,
    }


def test_signals_of_an_unwired_channel_are_left_out(bench: Bench) -> None:
    bench.add(DRIVE, 1, {"propulsion": MOTORS[0]})
    (bus,) = bench.build()
    assert not list(bench.report)
    names = [s.name for f in bus.frames for s in f.signals]
    assert "speed" in names
    assert not [n for n in names if n.startswith("steering")]
    # nobody steers: the command is not sent, the node still reports
    assert frame(bus, "d1_rpdo4").period is None
    assert frame(bus, "d1_tpdo1").period == CYCLE
    assert [(c.name, c.actuator) for c in bus.nodes[0].channels] == [
        ("propulsion", MOTORS[0].name),
        ("steering", None),
    ]


def test_two_propulsion_motors_on_one_controller(bench: Bench) -> None:
    left, right = MOTORS[0], MOTORS[2]
    bench.add(TWO_DRIVES, 1, {"left": left, "right": right})
    (bus,) = bench.build()
    assert not list(bench.report)
    joints = {
        f.name: [s.joint for s in f.signals if s.unit == "rad/s"]
        for f in bus.frames
        if f.period == CYCLE and f.signals
    }
    assert joints == {
        "d1_rpdo1": [left.joint],
        "d1_rpdo4": [right.joint],
        "d1_tpdo1": [left.joint, right.joint],
    }


def test_battery_broadcasts_and_an_empty_enclosure_does_not(bench: Bench) -> None:
    bench.add(BATTERY, 1)
    bench.add(BATTERY, params={"with_battery": False})
    (bus,) = bench.build(motors=())
    assert not list(bench.report)
    assert [(n.name, n.id, n.id_space) for n in bus.nodes] == [("d1", 1, "kc_battery")]
    # no CANopen node, so the master has nothing to say either
    assert [(f.cob_id, f.kind, f.producer) for f in bus.frames] == [
        (0x3C1, "broadcast", "d1"),
        (0x3D1, "broadcast", "d1"),
        (0x3E1, "broadcast", "d1"),
    ]
    assert signal(bus, "d1_status", "voltage").scale == 0.01


def test_every_library_device_has_a_clean_bus(bench: Bench) -> None:
    found = sorted(
        str(p.parent.relative_to(MODULES))
        for p in MODULES.glob("*/*/module.yaml")
        if "\ncan:\n" in p.read_text()
    )
    assert {DRIVE, TWO_DRIVES, BATTERY, "io/board"} <= set(found)
    roles = {"propulsion": MOTORS[0::2], "steering": MOTORS[1::2]}
    for i, name in enumerate(found):
        probe = Bench()
        probe.add(name)
        wires = {
            channel: roles[str(role.value)][(i + k) % 4]
            for k, (channel, node) in enumerate(_channels(probe.devices[0]))
            if (role := node.get("role")) is not None
        }
        bench.add(name, None, wires)
    bench.build((BusSpec("main", 500_000, line(99)),), motors=())
    assert {d.code.name for d in bench.report} <= {"motor-conflict"}  # wheels are few here


def _channels(device: Device) -> list[tuple[str, Node]]:
    channels = device.channels
    return list(channels.value.items()) if channels and isinstance(channels.value, dict) else []


# -- the bus --------------------------------------------------------------------------


def test_bitrate_that_a_node_cannot_do(bench: Bench) -> None:
    bench.drive(1)
    bench.add(BATTERY, 1)
    bench.build((BusSpec("main", 800_000, line(99)),))
    diagnostic = bench.only_diagnostic("can-bitrate")
    assert "d2" in diagnostic.message
    assert diagnostic.span == line(99)
    assert diagnostic.labels[0].span == line(2)


def test_bitrate_must_be_positive(bench: Bench) -> None:
    bench.drive(1)
    assert bench.build((BusSpec("main", 0, line(99)),)) == ()
    assert bench.only_diagnostic("can-bitrate").span == line(99)


@pytest.mark.parametrize("period", ["0", "-1 ms", "0.0 s"])
def test_period_must_be_positive(bench: Bench, period: str) -> None:
    bench.add("my/a", 6, text=simple(period=period), wires={"motor": MOTORS[0]})
    bench.build()
    assert bench.only_diagnostic("can-period").span is not None


def test_an_expression_at_fault_is_one_fault(bench: Bench) -> None:
    text = simple().replace("cob_id: 400", 'cob_id: "${unknown + id}"')
    assert "unknown" in text
    bench.add("my/a", 6, text=text, wires={"motor": MOTORS[0]})
    bench.build()
    (diagnostic,) = bench.report
    assert diagnostic.code.number.startswith("TV2")
    assert diagnostic.span is not None
    assert diagnostic.span.file == "my/a/module.yaml"


@pytest.mark.parametrize(
    ("drives", "cycle", "late"),
    [
        (1, 0.008, "`sync`, `d1_rpdo4` can"),
        (2, 0.008, "`sync`, `d1_rpdo4`, `d2_rpdo4` can"),
        (3, 0.012, "`sync`, `d1_rpdo4`, `d2_rpdo4` and 1 more can"),
    ],
)
def test_at_most_three_late_frames_are_named(
    bench: Bench, drives: int, cycle: float, late: str
) -> None:
    for _ in range(drives):
        bench.drive()
    bench.add(BATTERY)
    bench.add(BATTERY)
    bench.build((BusSpec("main", 250_000, line(99)),), cycle=cycle)
    (message,) = (d.message for d in bench.report if d.code.name == "can-deadline")
    assert late in message


def test_load_of_four_drives(bench: Bench) -> None:
    """Four two-channel drives fill half of 250 kbit/s at 50 Hz, and too much at 100 Hz.

    Before that the steering's commands come too late, which are less urgent than all reports.
    """
    for _ in range(4):
        bench.drive()
    bench.add(BATTERY)
    bench.add(BATTERY)
    slow = (BusSpec("main", 250_000, line(99)),)
    (bus,) = bench.build(slow)
    assert not list(bench.report)
    assert bus.load == pytest.approx(0.48, abs=0.005)
    bench.build(slow, cycle=0.014)
    warning, late = bench.report
    assert (warning.code.name, warning.span) == ("can-load", line(99))
    assert (late.code.name, late.span) == ("can-deadline", line(99))
    assert "`sync`, `d1_rpdo4`, `d2_rpdo4` and 2 more" in late.message
    assert "its deadline is 14 ms" in late.message
    bench.report = Report()
    (bus,) = bench.build(slow, cycle=0.01)
    assert bus.load == pytest.approx(0.87, abs=0.005)
    assert "80 %" in bench.only_diagnostic("can-overload").message
    late_frames = [f.name for f in bus.frames if f.deadline and f.response_time > f.deadline]
    assert late_frames == ["sync", "d1_rpdo4", "d2_rpdo4", "d3_rpdo4", "d4_rpdo4"]


# -- wiring ---------------------------------------------------------------------------


def test_motor_on_two_channels(bench: Bench) -> None:
    bench.drive(1)
    bench.drive(2, index=0)
    bench.build()
    faults = [d for d in bench.report if d.code.name == "motor-conflict"]
    assert [(f.span, f.labels[0].span) for f in faults] == [(line(2), line(1))] * 2


def test_role_of_the_channel(bench: Bench) -> None:
    bench.add(DRIVE, 1, {"propulsion": MOTORS[1]})
    bench.build()
    assert "propulsion" in bench.only_diagnostic("channel-role").message


def test_unknown_channel(bench: Bench) -> None:
    bench.add(DRIVE, 1, {"propulsion": MOTORS[0], "steerng": MOTORS[1]})
    bench.build(motors=MOTORS[:1])
    assert bench.only_diagnostic("channel-unknown").hint == "did you mean `steering`?"


def test_motors_without_a_controller(bench: Bench) -> None:
    bench.drive(1)
    bench.build(motors=MOTORS[:3])
    diagnostic = bench.only_diagnostic("motor-without-controller")
    assert MOTORS[2].name in diagnostic.message
    alone = Bench()
    assert alone.build(motors=MOTORS) == ()
    assert "8 motors" in alone.only_diagnostic("robot-without-controller").message


def test_controller_without_a_motor(bench: Bench) -> None:
    bench.add(DRIVE, 1)
    bench.build(motors=())
    assert bench.only_diagnostic("controller-without-motor").span == line(1)


def test_actuators_know_their_channel(bench: Bench) -> None:
    bench.drive(1)
    connected = connect_actuators(MOTORS[:3], bench.build())
    assert [(a.node, a.channel) for a in connected] == [
        ("d1", "propulsion"),
        ("d1", "steering"),
        (None, None),
    ]


@pytest.mark.parametrize(("rate", "period"), [(50.0, 0.02), (60.0, 0.016), (30.0, 0.033)])
def test_reports_come_by_a_timer_of_whole_milliseconds(
    bench: Bench, rate: float, period: float
) -> None:
    bench.drive(1)
    (bus,) = bench.build(cycle=1.0 / rate)
    assert not list(bench.report)
    frames = {frame.name.rpartition("_")[2]: frame for frame in bus.frames}
    assert frames["tpdo1"].period == period
    assert frames["rpdo1"].period == 1.0 / rate


def test_a_bus_without_a_bitrate_is_fast_enough(bench: Bench) -> None:
    for i in range(3):
        bench.drive(i + 1, index=i)
    spec = BusSpec("main", 500_000, line(99), stated=False)
    assert [bus.bitrate for bus in bench.build([spec])] == [500_000]
    assert not list(bench.report)
    (bus,) = bench.build([spec], cycle=0.005)
    assert bus.bitrate == 800_000
    note = bench.only_diagnostic("can-bitrate-chosen")
    assert "800 kbit/s" in note.message
    (stated,) = bench.build([spec._replace(stated=True)], cycle=0.005)
    assert stated.bitrate == 500_000
