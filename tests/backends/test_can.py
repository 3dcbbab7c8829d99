"""The CAN map and its DBC, read by cantools as an independent reader of our DBC."""

from __future__ import annotations

import dataclasses
import json
import math
import struct
from pathlib import Path
from typing import Any

import pytest

from tests.backend_files import dbc_message, dbc_of, files_of
from tests.buses import GEAR, LIMIT, MAX_SPEED, PPR, STEERING_GEAR, robot_with_bus
from tests.examples import SAMPLED_ROBOTS
from tests.robots import FOUR_STEERED, SPAN, make_robot
from tests.simulation.bus.robots import CIA402, compiled
from thorvaldc.backends.can import Can
from thorvaldc.backends.can.canmap import canmap_text
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Bus, FrameDefinition, Node, Robot, Signal

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    return files_of(Can, robot_with_bus())


@pytest.fixture(scope="module")
def canmap(files: dict[str, bytes]) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(files["can/canmap.json"])
    return loaded


@pytest.fixture
def database(files: dict[str, bytes]) -> Any:
    return read_dbc(files["can/robot.dbc"])


def read_dbc(data: bytes) -> Any:
    import cantools

    return cantools.database.load_string(data.decode("cp1252"), "dbc", strict=True)


def with_frame(frame: FrameDefinition, node: Node | None = None) -> Robot:
    robot = robot_with_bus()
    bus = robot.buses[0]
    bus = dataclasses.replace(
        bus, frames=(*bus.frames, frame), nodes=(*bus.nodes, node) if node else bus.nodes
    )
    return dataclasses.replace(robot, buses=(bus,))


def test_canmap_names_bus_master_and_nodes(canmap: dict[str, Any]) -> None:
    (bus,) = canmap["buses"]
    assert (bus["name"], bus["bitrate"], bus["sync_period"]) == ("main", 500_000, 0.02)
    assert bus["master"] == {"name": "master", "id": 127}
    assert [
        (n["name"], n["module"], n["id"], n["id_space"], n["serial"]) for n in bus["nodes"]
    ] == [
        ("w0_controller", "w0.controller", 3, "canopen", None),
        ("w1_controller", "w1.controller", 2, "canopen", None),
        ("battery", "battery", 1, "kc_battery", "0x12"),
    ]
    assert bus["nodes"][0]["properties"] == {"heartbeat_timeout": 2.0}


def test_canmap_channels_have_joints_and_scalings(canmap: dict[str, Any]) -> None:
    propulsion, steering = canmap["buses"][0]["nodes"][0]["channels"]
    assert (propulsion["actuator"], propulsion["joint"]) == ("w0_propulsion", "w0_axle")
    assert (steering["lower"], steering["upper"]) == (-LIMIT, LIMIT)
    by_signal = {(s["frame"], s["signal"]): s for s in propulsion["signals"] + steering["signals"]}
    assert {k: (s["direction"], s["unit"]) for k, s in by_signal.items()} == {
        ("w0_controller_rpdo1", "speed"): ("command", "rad/s"),
        ("w0_controller_tpdo1", "propulsion_velocity"): ("report", "rad/s"),
        ("w0_controller_rpdo4", "position"): ("command", "rad"),
        ("w0_controller_tpdo1", "steering_position"): ("report", "rad"),
    }
    # 1000 is the motor's full speed and the joint's full angle
    assert 1000 * by_signal["w0_controller_rpdo1", "speed"]["scale"] == pytest.approx(
        MAX_SPEED / GEAR
    )
    assert 1000 * by_signal["w0_controller_rpdo4", "position"]["scale"] == pytest.approx(LIMIT)


def test_canmap_frames_have_every_field_of_the_model(canmap: dict[str, Any]) -> None:
    frames = canmap["buses"][0]["frames"]
    for stored, frame in zip(frames, robot_with_bus().buses[0].frames, strict=True):
        for field in dataclasses.fields(frame):
            if field.name in ("span", "signals"):
                continue
            value = getattr(frame, field.name)
            if field.name == "extended":
                assert (field.name in stored) is value
                continue
            assert stored[field.name] == (list(value) if isinstance(value, tuple) else value)
        for signal, read in zip(frame.signals, stored["signals"], strict=True):
            expected = dataclasses.asdict(signal)
            assert expected.pop("big_endian") is read.pop("big_endian", False)
            expected["choices"] = {name: raw for raw, name in signal.choices}
            expected["selected_by"] = list(signal.selected_by)
            assert read == expected


def test_dbc_has_the_frames_of_the_canmap(canmap: dict[str, Any], database: Any) -> None:
    bus = canmap["buses"][0]
    assert [n.name for n in database.nodes] == ["master", *(n["name"] for n in bus["nodes"])]
    assert database.buses[0].baudrate == bus["bitrate"]
    by_id = {m.frame_id: m for m in database.messages}
    assert len(by_id) == len(bus["frames"])
    for frame in bus["frames"]:
        message = by_id[frame["cob_id"]]
        assert message.name == frame["name"]
        assert message.length == frame["length"]
        assert message.senders == [frame["producer"]]
        period = frame["period"]
        assert message.cycle_time == (None if period is None else round(1000 * period))
        assert not message.is_extended_frame
        signals = {s.name: s for s in message.signals}
        assert set(signals) == {s["name"] for s in frame["signals"]}
        for wanted in frame["signals"]:
            signal = signals[wanted["name"]]
            assert (signal.start, signal.length) == (wanted["start"], wanted["length"])
            assert signal.byte_order == "little_endian"
            assert signal.is_signed == wanted["signed"]
            assert (signal.scale, signal.offset) == (wanted["scale"], wanted["offset"])
            assert (signal.unit or "") == wanted["unit"]
            assert signal.is_multiplexer == wanted["multiplexer"]
            assert (signal.multiplexer_ids or []) == wanted["selected_by"]
            assert {str(v): k for k, v in (signal.choices or {}).items()} == wanted["choices"]
            assert signal.receivers == frame["consumers"]


def test_cantools_decodes_and_encodes_the_published_scalings(database: Any) -> None:
    data = struct.pack("<hhi", 1260, 0, -4 * PPR)  # 1260 rpm of the motor, one turn back
    read = database.decode_message(0x183, data)
    assert read["propulsion_velocity"] == pytest.approx(1260 / GEAR * math.pi / 30)
    assert read["steering_position"] == pytest.approx(-2 * math.pi / STEERING_GEAR)
    sent = database.encode_message(0x203, {"sequence": 7, "speed": -MAX_SPEED / GEAR / 2})
    assert struct.unpack("<ii", sent) == (7, -500)
    assert struct.unpack("<ii", database.encode_message(0x503, {"position": LIMIT}))[1] == 1000
    battery = database.decode_message(0x3C1, struct.pack("<xxHxxbx", 4825, 12))
    assert battery == {"voltage": pytest.approx(48.25), "temperature": -28}


def test_the_scale_of_an_inverted_motor_is_negative() -> None:
    """The CAN map and the DBC have the same sign as the driver, the DCF is as before."""
    usual, inverted = (
        files_of(Can, compiled(CIA402.replace("_steering}", f"_steering{more}}}")))
        for more in ("", ", inverted: true, steering_inverted: true")
    )
    data = struct.pack("<Hbi", 0, 3, 1000)
    for cob_id, name in ((0x181, "propulsion_velocity"), (0x281, "steering_position")):
        value, other = (
            read_dbc(each["can/robot.dbc"]).decode_message(cob_id, data)[name]
            for each in (usual, inverted)
        )
        assert 0.0 < value == -other
    signals = [
        signal
        for node in json.loads(inverted["can/canmap.json"])["buses"][0]["nodes"]
        for channel in node["channels"]
        for signal in channel["signals"]
    ]
    assert len(signals) == 16
    assert all(signal["scale"] < 0.0 for signal in signals)
    assert b"scale_pos_from_dev: -" in inverted["can/bus.yml"]
    dcfs = [path for path in usual if path.endswith("_controller.dcf")]
    assert [inverted[path] for path in dcfs] == [usual[path] for path in dcfs]


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (struct.pack("<xxxBI", 1, 77), {"content": "configuration", "configuration": 77}),
        (
            bytes([0, 0, 0, 2, 9, 1, 2, 3]),
            {"content": "version", "controller_type": 9, "version_major": 3},
        ),
        (struct.pack("<xxxBHxx", 3, 4096), {"content": "encoder", "propulsion_encoder_ppr": 4096}),
    ],
)
def test_multiplexed_frame_is_read_by_its_selector(
    database: Any, data: bytes, expected: dict[str, object]
) -> None:
    assert database.decode_message(0x482, data) == expected


def test_texts_that_are_not_valid_in_a_dbc_are_replaced() -> None:
    signal = Signal(
        "x",
        0,
        8,
        unit='"',
        choices=((1, 'a "b"'),),
        description='ends with \\ and "quotes"\nand ; \u0394',
    )
    frame = FrameDefinition(
        "odd", 0x101, "relay", "master", ("battery",), 1, None, None, (signal,), SPAN, "\u0394"
    )
    robot = with_frame(frame)
    message = read_dbc(files_of(Can, robot)["can/robot.dbc"]).get_message_by_name("odd")
    assert message.comment == "?"
    assert str(message.signals[0].choices[1]) == "a 'b'"
    assert message.signals[0].comment == "ends with / and 'quotes' and ; ?"
    (warning,) = Can().unsupported(robot)
    assert warning.code.name == "dbc-text"
    assert "\u0394" in warning.message


@pytest.mark.parametrize(
    ("limits", "read"),
    [
        ({}, (None, None)),
        ({"minimum": 5.0}, (5.0, 12.7)),
        ({"maximum": -5.0}, (-12.8, -5.0)),
        ({"minimum": -1.0, "maximum": 1.0}, (-1.0, 1.0)),
    ],
)
def test_limits_of_a_signal(limits: dict[str, float], read: tuple[float, float]) -> None:
    signal = Signal("x", 0, 8, signed=True, scale=0.1, **limits)
    frame = FrameDefinition(
        "odd", 0x181, "pdo", "master", ("battery",), 1, None, None, (signal,), SPAN
    )
    message = read_dbc(files_of(Can, with_frame(frame))["can/robot.dbc"]).get_message_by_name("odd")
    (signal,) = message.signals
    assert (signal.minimum, signal.maximum) == (
        read if read[0] is None else pytest.approx(read, rel=1e-12)
    )


def test_long_names_are_kept() -> None:
    name = "a_drive_with_a_name_that_is_longer_than_32_characters_controller"
    node = Node(name, name, "p", 9, "canopen", None, None, (), (), SPAN)
    frame = FrameDefinition(
        f"{name}_tpdo1", 0x189, "pdo", name, ("master",), 8, 90.0, 1.0, (), SPAN
    )
    database = read_dbc(files_of(Can, with_frame(frame, node))["can/robot.dbc"])
    message = database.get_message_by_frame_id(0x189)
    assert (message.name, message.senders) == (f"{name}_tpdo1", [name])


def test_every_bus_has_its_dbc() -> None:
    robot = robot_with_bus()
    second = Bus("implement", 250_000, 0.02, (), (), SPAN)
    files = files_of(Can, dataclasses.replace(robot, buses=(*robot.buses, second)))
    assert sorted(p for p in files if p.endswith(".dbc")) == ["can/implement.dbc", "can/main.dbc"]
    assert read_dbc(files["can/implement.dbc"]).buses[0].baudrate == 250_000


def test_a_value_that_is_no_json_is_no_text_in_the_map() -> None:
    robot = dataclasses.replace(robot_with_bus(), namespace=Path("r1"))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"canmap.json cannot contain"):
        canmap_text(robot)


def test_a_robot_without_a_bus_has_an_empty_map() -> None:
    files = files_of(Can, make_robot(FOUR_STEERED))
    assert list(files) == ["can/canmap.json"]
    assert json.loads(files["can/canmap.json"])["buses"] == []


@pytest.mark.parametrize(
    "path", [EXAMPLES / name / "robot.yaml" for name in SAMPLED_ROBOTS], ids=SAMPLED_ROBOTS
)
def test_examples(path: Path) -> None:
    """cantools decodes every frame of every example with the scalings of the model."""
    robot = compile_file(path).model
    assert isinstance(robot, Robot)
    files = files_of(Can, robot)
    assert not list(Can().unsupported(robot))
    driven = {
        (channel["joint"], signal["unit"], signal["direction"])
        for bus in json.loads(files["can/canmap.json"])["buses"]
        for node in bus["nodes"]
        for channel in node["channels"]
        if channel["actuator"]
        for signal in channel["signals"]
    }
    for actuator in robot.actuators:
        unit = "rad/s" if actuator.role == "propulsion" else "rad"
        assert {(actuator.joint, unit, "command"), (actuator.joint, unit, "report")} <= driven
    frames = [(bus, frame) for bus in robot.buses for frame in bus.frames]
    databases = {bus.name: read_dbc(dbc_of(robot, bus, files)) for bus in robot.buses}
    for bus, frame in frames:
        data = bytes((37 * frame.cob_id + 101 * i) % 251 for i in range(frame.length))
        if any(signal.multiplexer for signal in frame.signals):
            data = data[:3] + b"\x02" + data[4:]
        read = dbc_message(databases[bus.name], frame).decode(data, decode_choices=False)
        shown = [s for s in frame.signals if not s.selected_by or 2 in s.selected_by]
        assert list(read) == [s.name for s in sorted(shown, key=lambda s: s.start)]
        for signal in shown:
            # A big-endian number has its bits from the most significant one on, byte by byte.
            low = signal.start
            if signal.big_endian:
                low = 8 * frame.length - (signal.start ^ 7) - signal.length
            word = int.from_bytes(data, "big" if signal.big_endian else "little")
            raw: float = word >> low & ((1 << signal.length) - 1)
            if signal.floating_point:
                (raw,) = struct.unpack_from("<f", data, signal.start // 8)
            elif signal.signed and raw >= 1 << (signal.length - 1):
                raw -= 1 << signal.length
            assert read[signal.name] == pytest.approx(raw * signal.scale + signal.offset, rel=1e-12)
