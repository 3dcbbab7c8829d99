"""Modules from DBC files: what a module decodes is what cantools decodes with the file itself."""

from __future__ import annotations

import math
import random
import re
from pathlib import Path
from typing import Any

import cantools.database
import pytest

from tests.backends.random_layouts import compiled_bus, random_module
from tests.cli.conftest import Command
from tests.devices import MOTORS, Bench, line
from thorvaldc.backends.can.dbc import dbc_text
from thorvaldc.compiler.bus.device_file import MAX_BYTES
from thorvaldc.compiler.bus.device_sections import BusSpec
from thorvaldc.model import Bus

BATTERY = Path(__file__).with_name("battery.dbc").read_text(encoding="utf-8")
DRIVE = """\
VERSION ""
NS_ :
BS_:
BU_: Drive Host
BO_ 300 Status: 8 Drive
 SG_ MotorSpeed : 7|16@0- (0.5,0) [0|0] "rpm" Host
 SG_ MotorCurrent : 23|16@0- (0.1,0) [0|0] "A" Host
BO_ 301 Command: 8 Host
 SG_ MotorSpeedRef : 7|16@0- (0.5,0) [-16000|16000] "1/min" Drive
 SG_ Enable : 16|1@1+ (1,0) [0|1] "" Drive
"""
ROBOT = """\
thorvaldc: 1
name: rover
base_calculator: differential
library: [modules]
buses: {main: {}, mine: {bitrate: 250 kbit/s}}
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, cross_members: [0]}}
  left: {type: assembly/fixed_drive, mount: frame.front_left}
  right: {type: assembly/fixed_drive, mount: frame.front_right}
  controller:
    type: controller/propulsion_propulsion
    channels: {left: left.propulsion, right: right.propulsion}
    can: 1
  caster_left: {type: caster/swivel, mount: frame.rear_left}
  caster_right: {type: caster/swivel, mount: frame.rear_right}
  battery: {type: battery/mine, mount: {parent: frame, xyz: [0, 0, 25 mm]}, can: {bus: mine, id: 1}}
"""


def import_node(command: Command, type_name: str, node: str, text: str) -> str:
    """Runs the command, and returns the text of the module."""
    Path("mine.dbc").write_text(text, encoding="cp1252")
    made = command("modules", "from-dbc", type_name, "mine.dbc", "--node", node)
    assert made.status == 0, made.err
    return Path(f"modules/{type_name}/module.yaml").read_text(encoding="utf-8")


def built(text: str, wires: dict[str, Any] | None = None) -> Bus:
    """Returns the bus of a robot with this module."""
    bench = Bench()
    bench.add("my/device", 1, wires, text=text)
    (bus,) = bench.build((BusSpec("main", 250_000, line(99)),))
    assert not bench.report.errors
    return bus


def database_of(text: str) -> Any:
    return cantools.database.load_string(text, "dbc", strict=True)


def compare(ours: Bus, text: str, draw: random.Random, factors: dict[str, float]) -> int:
    """Compares random frames, decoded with our DBC and with the input; returns the values compared.

    Signals have other names here and there, so that their bits and their multiplexer tell them.
    ``factors``: units of ours in one of the input, by the name of the signal in the input.
    """
    own, other, count = database_of(dbc_text(ours)), database_of(text), 0
    for message in own.messages:
        theirs = other.get_message_by_frame_id(message.frame_id)
        assert theirs.is_extended_frame == message.is_extended_frame
        names = {bits(signal): signal.name for signal in message.signals}
        for _ in range(20):
            data = bytearray(draw.randbytes(message.length))
            for signal in message.signals:
                if signal.is_multiplexer:  # a value without signals is an error of cantools
                    values = [i for s in message.signals for i in s.multiplexer_ids or ()]
                    data[signal.start // 8] = draw.choice(values)
            read = message.decode(bytes(data), decode_choices=False)
            for name, value in theirs.decode(bytes(data), decode_choices=False).items():
                expected = value * factors.get(name, 1.0)
                got = read[names[bits(theirs.get_signal_by_name(name))]]
                assert got == pytest.approx(expected, rel=1e-12, nan_ok=True), name
                count += 1
    return count


def bits(signal: Any) -> tuple[object, ...]:
    return signal.start, signal.length, signal.byte_order, tuple(signal.multiplexer_ids or ())


def test_a_battery_decodes_as_its_dbc(thorvaldc: Command) -> None:
    text = import_node(thorvaldc, "battery/mine", "BMS", BATTERY)
    bus = built(text)
    assert [hex(frame.cob_id) for frame in bus.frames] == ["0x18fef0f0", "0x321", "0x200"]
    assert compare(bus, BATTERY, random.Random(1), {"PackVoltage": 0.001}) > 100
    signals = {signal.name: signal for frame in bus.frames for signal in frame.signals}
    assert {name: signals[name].unit for name in ("voltage", "current", "state_of_charge")} == {
        "voltage": "V",
        "current": "A",
        "state_of_charge": "%",
    }
    assert signals["content"].choices == ((0, "zero_a"), (1, "one_b"), (2, "one_b_2"))
    assert signals["current_limit"].maximum == 200.0
    assert bus.frames[0].period == 0.1


def test_the_module_is_valid_in_a_robot_at_once(thorvaldc: Command) -> None:
    text = import_node(thorvaldc, "battery/mine", "BMS", BATTERY)
    assert "bitrates: [250 kbit/s]" in text
    assert re.search(r"# Positive while the battery discharges\?.*\n +current:", text)
    assert "`state_of_health` in % is not bound" in text
    Path("robot.yaml").write_text(ROBOT, encoding="utf-8")
    for arguments in (["modules", "check", "modules"], ["check", "robot.yaml"]):
        checked = thorvaldc(*arguments)
        assert (checked.status, checked.err) == (0, ""), checked.out


def test_a_module_is_not_replaced(thorvaldc: Command) -> None:
    import_node(thorvaldc, "battery/mine", "BMS", BATTERY)
    again = thorvaldc("modules", "from-dbc", "battery/mine", "mine.dbc", "--node", "BMS")
    assert again.status == 2
    assert "exists already" in again.err


def test_the_speed_of_a_motor_is_that_of_its_joint(thorvaldc: Command) -> None:
    text = import_node(thorvaldc, "controller/mine", "Drive", DRIVE)
    motor = MOTORS[0]
    bus = built(text, {"motor": motor})
    factor = math.pi / 30 / motor.gear_ratio
    assert compare(bus, DRIVE, random.Random(2), dict.fromkeys(SPEEDS, factor)) == 80
    assert [frame.kind for frame in bus.frames] == ["pdo", "pdo"]
    unwired = built(text)  # without a motor, the signals of the motor are left out
    assert [len(frame.signals) for frame in unwired.frames] == [1, 1]


SPEEDS = ("MotorSpeed", "MotorSpeedRef")


@pytest.mark.parametrize(
    ("text", "comment"),
    [
        (DRIVE.replace("MotorSpeed ", "Speed "), "of motor or wheel? status.speed"),
        (DRIVE.replace("MotorCurrent", "WheelSpeed").replace('"A"', '"rpm"'), "one of status.m"),
        (DRIVE.replace('"rpm"', '""'), "`velocity` in rad/s is not bound: none"),
    ],
    ids=["of what", "two", "no unit"],
)
def test_what_is_ambiguous_is_not_guessed(thorvaldc: Command, text: str, comment: str) -> None:
    module = import_node(thorvaldc, "controller/mine", "Drive", text)
    assert re.search(rf"^# .*{re.escape(comment)}", module, re.MULTILINE)
    assert "        velocity:" not in module


def test_random_layouts_return(thorvaldc: Command) -> None:
    draw = random.Random(3)
    for number in range(4):
        bus = compiled_bus(random_module(draw))
        text = dbc_text(bus)
        module = import_node(thorvaldc, f"other/m{number}", "d1", text)
        assert compare_all(compiled_bus(module), bus, text, draw) > 100


def compare_all(again: Bus, bus: Bus, text: str, draw: random.Random) -> int:
    """Compares frames that have the same number with 11 and with 29 bits one by one."""
    count = 0
    own, other = database_of(dbc_text(again)), database_of(text)
    assert len(again.frames) == len(bus.frames)
    for message, theirs in zip(own.messages, other.messages, strict=True):
        assert (message.frame_id, message.is_extended_frame) == (
            theirs.frame_id,
            theirs.is_extended_frame,
        )
        names = {bits(signal): signal.name for signal in message.signals}
        for _ in range(10):
            data = draw.randbytes(message.length)
            read = message.decode(data, decode_choices=False)
            expected = theirs.decode(data, decode_choices=False)
            for signal in theirs.signals:
                value = expected[signal.name]
                assert read[names[bits(signal)]] == pytest.approx(value, rel=1e-12, nan_ok=True)
                count += 1
    return count


LEFT_OUT = """\
VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 1 Long: 16 A
 SG_ far : 64|8@1+ (1,0) [0|0] "" B
BO_ 2 Odd: 8 A
 SG_ good : 0|8@1+ (1,0) [0|0] "" B
 SG_ again : 4|8@1+ (1,0) [0|0] "" B
 SG_ outside : 60|8@1+ (1,0) [0|0] "" B
 SG_ flat : 16|8@1+ (0,0) [0|0] "" B
 SG_ huge : 24|8@1+ (1E999,0) [0|0] "" B
BO_ 3 Nested: 8 A
 SG_ top M : 0|8@1+ (1,0) [0|0] "" B
 SG_ inner m1M : 8|8@1+ (1,0) [0|0] "" B
 SG_ deep m2 : 16|8@1+ (1,0) [0|0] "" B
VAL_ 2 good 300 "far" 1 "near";
SG_MUL_VAL_ 3 inner top 1-1;
SG_MUL_VAL_ 3 deep inner 2-2;
"""


def test_what_cannot_be_said_is_left_out_by_name(thorvaldc: Command) -> None:
    Path("mine.dbc").write_text(LEFT_OUT, encoding="utf-8")
    made = thorvaldc("modules", "from-dbc", "io/mine", "mine.dbc", "--node", "A")
    notes = dict(re.findall(r"mine\.dbc:(\d+):1: note\[TV936\] \S+ the \w+ (`\S+`)", made.err))
    assert notes == {
        "5": "`Long`",
        "8": "`far`",
        "9": "`again`",
        "10": "`outside`",
        "11": "`flat`",
        "12": "`Odd.huge`",
        "16": "`Nested.deep`",
    }
    text = Path("modules/io/mine/module.yaml").read_text(encoding="utf-8")
    assert "choices: {near: 1}" in text
    assert compare(compiled_bus(text), LEFT_OUT_READ, random.Random(4), {}) > 20


LEFT_OUT_READ = re.sub(
    r"\n SG_ (again|outside|flat|huge|deep|far) .*|\nSG_MUL.*", "", LEFT_OUT
).replace("m1M", "m1")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (BATTERY.replace("[0|90000]", "[0|90000"), "mine.dbc:6:45: error[TV903]"),
        ("", "mine.dbc:1:1: error[TV903]"),
        (BATTERY.replace("BMS", "BNS"), "did you mean `BNS`?"),
        ("\0" * 100, "mine.dbc:1:1: error[TV903]"),
        ("x" * (MAX_BYTES + 1), "more than 4 MB"),
        (BATTERY.replace("BO_ 513", "BO_ 2049"), "mine.dbc:18:1: error[TV903]"),
    ],
    ids=["syntax", "empty", "other node", "bytes", "large", "identifier"],
)
def test_broken_files(thorvaldc: Command, content: str, message: str) -> None:
    Path("mine.dbc").write_text(content, encoding="utf-8")
    made = thorvaldc("modules", "from-dbc", "battery/mine", "mine.dbc", "--node", "BMS")
    assert made.status == 1, made.err
    assert message in made.err
    assert not Path("modules").exists()
