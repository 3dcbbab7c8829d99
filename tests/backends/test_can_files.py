"""The other files of the `can` target, read by the programs that they are for."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import canopen
import pytest
import yaml

from tests.backend_files import files_of
from tests.buses import robot_with_bus
from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.robots import FOUR_STEERED, SPAN, make_robot
from thorvaldc.backends.can import Can
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Bus, FrameDefinition, Robot, Signal

DRIVES = """\
thorvaldc: 1
name: drives
driver: {rate: 50 Hz}
defaults: {drive: {controller: controller/cia402_propulsion_steering}}
foreign_devices:
  sprayer: {frames: {go: {cob_id: 0x205, direction: command, rate: 10 Hz}}}
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: {id: 3, serial: "0x1003"}}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: {id: 2, serial: "4098"}}
  rear: {type: assembly/fixed_drive, mount: frame.rear_center, params: {controller: none}}
  one: {type: controller/cia402_propulsion, channels: {propulsion: rear.propulsion}, can: 4,
        params: {vendor_id: 0x1234, product_code: 7}}
  io: {type: io/board, can: 32}
  battery: {type: battery/enclosure, mount: {parent: frame}, can: 1}
"""


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Two drives with two axes, one with one axis, an IO board, a battery and a sprayer."""
    path = tmp_path_factory.mktemp("drives") / "robot.yaml"
    path.write_text(DRIVES, encoding="utf-8")
    compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    return compilation.model


@pytest.fixture(scope="module")
def files(drives: Robot) -> dict[str, bytes]:
    return files_of(Can, drives)


# -- DCF ----------------------------------------------------------------------------------


def imported_dcf(files: dict[str, bytes], node: str, folder: Path) -> Any:
    path = folder / f"{node}.dcf"
    path.write_bytes(files[f"can/dcf/{node}.dcf"])
    return canopen.objectdictionary.import_od(str(path))


def test_every_node_with_an_object_dictionary_has_a_dcf(files: dict[str, bytes]) -> None:
    assert sorted(p for p in files if p.startswith("can/dcf/")) == [
        "can/dcf/fl_controller.dcf",
        "can/dcf/fr_controller.dcf",
        "can/dcf/one.dcf",
    ]


def test_canopen_reads_the_identity(files: dict[str, bytes], tmp_path: Path) -> None:
    od = imported_dcf(files, "one", tmp_path)
    assert (od.node_id, od.bitrate) == (4, 500_000)
    info = od.device_information
    assert (info.vendor_number, info.product_number, info.LSS_supported) == (0x1234, 7, True)
    assert info.allowed_baudrates == {125_000, 250_000, 500_000, 800_000, 1_000_000}
    assert od[0x1000].default == 0x20192
    assert [od[0x1018][i].default for i in (1, 2, 3)] == [0x1234, 7, 0x10000]
    text = files["can/dcf/fl_controller.dcf"].decode()
    assert "\nNodeName=fl_controller\n" in text
    assert "\nLSS_SerialNumber=4099\n" in text
    assert "LSS_SerialNumber" not in files["can/dcf/one.dcf"].decode()
    assert imported_dcf(files, "fl_controller", tmp_path)[0x1000].default == 0xFFFF0192


def test_canopen_reads_heartbeats_and_the_reaction_to_their_loss(
    files: dict[str, bytes], tmp_path: Path
) -> None:
    od = imported_dcf(files, "fl_controller", tmp_path)
    assert od[0x1017].value == 100
    assert od[0x1016][1].value == 127 << 16 | 500
    assert od[0x1014].value == 0x083
    for axis in (0, 0x800):
        assert od[0x6007 + axis].value == 3  # quick stop when the master is lost
        assert od[0x605A + axis].value == 2
    assert (od[0x6060].value, od[0x6860].value) == (3, 1)  # profile velocity, profile position


def test_canopen_reads_the_pdos_of_the_map(
    drives: Robot, files: dict[str, bytes], tmp_path: Path
) -> None:
    (bus,) = drives.buses
    for node in bus.nodes:
        pdos = [f for f in bus.frames if f.pdo and node.name in (f.producer, *f.consumers)]
        od = imported_dcf(files, node.name, tmp_path) if pdos else None
        for frame in pdos:
            base = (0x1800 if frame.producer == node.name else 0x1400) + frame.pdo - 1
            assert od[base][1].value == frame.cob_id
            assert od[base][2].value == (1 if frame.synchronous else 255)
            mapping = od[base + 0x200]
            assert mapping[0].value == len(frame.mapping)
            start = 0
            for i in range(1, mapping[0].value + 1):
                entry = mapping[i].value
                index, subindex, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
                mapped = od[index]
                assert mapped.pdo_mappable
                assert mapped.access_type == ("ro" if frame.producer == node.name else "rww")
                assert (len(mapped), subindex) == (bits, 0)  # canopen counts bits
                signal = next(s for s in frame.signals if s.start == start)
                assert (signal.length, signal.name) == (bits, mapped.name)
                assert signal.signed == (mapped.data_type in canopen.objectdictionary.SIGNED_TYPES)
                start += bits
            assert start == 8 * frame.length


def test_canopen_reads_limits_in_units_of_the_drive(
    drives: Robot, files: dict[str, bytes], tmp_path: Path
) -> None:
    od = imported_dcf(files, "fl_controller", tmp_path)
    joint = drives.joint("fl_steering_joint")
    actuator = drives.actuator_of(joint.name)
    assert actuator is not None
    assert joint.upper is not None
    step = next(
        s.scale for f in drives.buses[0].frames for s in f.signals
        if s.joint == joint.name and s.unit == "rad"
    )  # fmt: skip
    assert od[0x687D][1].value * step == pytest.approx(joint.lower, abs=step)
    assert od[0x687D][2].value * step == pytest.approx(joint.upper, abs=step)
    assert od[0x687F].value * step == pytest.approx(actuator.max_velocity, abs=step)
    assert od[0x6883].value * step == pytest.approx(actuator.max_acceleration, abs=step)
    assert od[0x6880].value == 3000
    assert od[0x687D][1].value == -85996


def test_objects_of_cia_402_are_only_in_drives_of_cia_402() -> None:
    robot = example_robot("4wd4ws_slim")
    text = files_of(Can, robot)["can/dcf/fl_controller.dcf"].decode()
    indices = {int(i, 16) for i in re.findall(r"^\[([0-9A-F]{4})\]", text, re.M)}
    assert {0x1017, 0x1018, 0x1400, 0x1603, 0x1803, 0x1A00, 0x2005, 0x2106} <= indices
    assert not [i for i in indices if i >= 0x6000]
    assert "LSS_Supported=0" in text


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_canopen_reads_every_dcf_of_the_examples(name: str, tmp_path: Path) -> None:
    robot = example_robot(name)
    files = files_of(Can, robot)
    dcf_paths = [p for p in files if p.startswith("can/dcf/")]
    assert bool(dcf_paths) is any(node.is_canopen for node in robot.buses[0].nodes)
    for path in dcf_paths:
        od = imported_dcf(files, Path(path).stem, tmp_path)
        assert {0x1000, 0x1001, 0x1017, 0x1018} <= set(od)
        listed = re.findall(r"^\d+=(0x[0-9A-F]{4})$", files[path].decode(), re.M)
        assert sorted(int(i, 16) for i in listed) == sorted(od)
        assert b"Date" not in files[path]
        assert b"Time" not in files[path]


# -- C header --------------------------------------------------------------------------------


def compiled(header: bytes, main: str, folder: Path, cc: str) -> list[str]:
    """Return the lines that a program with the header prints; all warnings are errors."""
    (folder / "robot_can.h").write_bytes(header)
    source = f'#include "robot_can.h"\n#include "robot_can.h"\n#include <stdio.h>\n{main}'
    (folder / "main.c").write_text(source)
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([cc, *flags, "-o", "main", "main.c"], cwd=folder, check=True)
    process = subprocess.run(["./main"], cwd=folder, capture_output=True, text=True, check=True)
    return process.stdout.splitlines()


def test_c_program_has_the_ids_and_scales_of_the_map(
    drives: Robot, files: dict[str, bytes], tmp_path: Path, cc: str
) -> None:
    expected, lines = [], []
    for frame in drives.buses[0].frames:
        prefix = f"ROBOT_CAN_MAIN_{frame.name}".upper()
        lines.append(f'printf("%u %u\\n", {prefix}_COB_ID, {prefix}_LENGTH);')
        expected.append((frame.cob_id, frame.length))
        for signal in frame.signals:
            macro = f"{prefix}_{signal.name}".upper()
            lines.append(f'printf("%u %u %.17g\\n", {macro}_START, {macro}_BITS, {macro}_SCALE);')
            expected.append((signal.start, signal.length, signal.scale))
    main = "int main(void) {\n" + "\n".join(lines) + "\nreturn 0; }\n"
    printed = compiled(files["can/robot_can.h"], main, tmp_path, cc)
    assert [tuple(float(n) for n in line.split()) for line in printed] == expected


def test_names_and_texts_that_are_not_valid_in_a_header(tmp_path: Path, cc: str) -> None:
    signals = (
        Signal("b", 0, 8, unit="*/ \\", choices=((-1, "start"), (1, "scale"))),
        Signal("b_is", 8, 8, scale=-0.5, offset=-3.0, unit="°C", choices=((0, "x"),)),
    )
    odd = FrameDefinition("a", 0x190, "relay", "master", ("battery",), 8, None, None, signals, SPAN)
    clash = FrameDefinition("a_b", 0x191, "relay", "master", ("battery",), 8, None, None,
                  (Signal("start", 0, 8), Signal("is_start", 0, 8)), SPAN)  # fmt: skip
    robot = robot_with_bus()
    bus = dataclasses.replace(robot.buses[0], frames=(odd, clash))
    header = files_of(Can, dataclasses.replace(robot, buses=(bus,)))["can/robot_can.h"]
    main = 'int main(void) { printf("%g %g %d\\n", ROBOT_CAN_MAIN_A_B_IS_OFFSET, \
        ROBOT_CAN_MAIN_A_B_IS_SCALE_2, ROBOT_CAN_MAIN_A_B_IS_START); return 0; }\n'
    assert compiled(header, main, tmp_path, cc) == ["-3 -0.5 -1"]


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_header_of_an_example_compiles(name: str, tmp_path: Path, cc: str) -> None:
    robot = example_robot(name)
    header = files_of(Can, robot)["can/robot_can.h"]
    bitrate = f"ROBOT_CAN_{robot.buses[0].name.upper()}_BITRATE"
    main = f'int main(void) {{ printf("%lu\\n", {bitrate}); return 0; }}\n'
    assert compiled(header, main, tmp_path, cc) == ["500000"]


# -- bus.yml ---------------------------------------------------------------------------------


def test_ros2_canopen_finds_nodes_dcfs_and_heartbeats_on(files: dict[str, bytes]) -> None:
    bus = yaml.safe_load(files["can/bus.yml"])
    master = bus["master"]
    assert (master["node_id"], master["baudrate"], master["sync_period"]) == (127, 500, 20_000)
    assert (master["heartbeat_consumer"], master["heartbeat_producer"]) == (True, 100)
    assert master["heartbeat_multiplier"] == 5  # the nodes wait 500 ms
    assert {name: node["node_id"] for name, node in bus["nodes"].items()} == {
        "fl_controller": 3,
        "fr_controller": 2,
        "one": 4,
    }
    for node in bus["nodes"].values():
        assert f"can/{node['dcf']}" in files
        assert node["driver"] == "ros2_canopen::Cia402Driver"
        assert (node["heartbeat_consumer"], node["heartbeat_producer"]) == (True, 100)
        assert node["heartbeat_multiplier"] == 5
    assert bus["nodes"]["fr_controller"]["serial_number"] == 4098


def test_ros2_canopen_knows_axes_and_scales(drives: Robot, files: dict[str, bytes]) -> None:
    nodes = yaml.safe_load(files["can/bus.yml"])["nodes"]
    propulsion, steering = nodes["fl_controller"]["channels"]
    assert nodes["fl_controller"]["num_channels"] == 2
    assert (propulsion["velocity_mode"], steering["position_mode"]) == (3, 1)
    actuator = drives.actuator_of("fl_steering_joint")
    assert actuator is not None
    counts = 4 * actuator.encoder_ppr * actuator.gear_ratio
    assert steering["scale_pos_to_dev"] == pytest.approx(counts / 6.283185307179586)
    assert steering["scale_pos_from_dev"] * steering["scale_pos_to_dev"] == pytest.approx(1.0)
    assert nodes["one"]["scale_vel_to_dev"] > 0
    assert "channels" not in nodes["one"]


def test_drives_of_another_profile_get_a_proxy() -> None:
    bus = yaml.safe_load(files_of(Can, example_robot("4wd4ws_slim"))["can/bus.yml"])
    node = bus["nodes"]["fl_controller"]
    assert node["driver"] == "ros2_canopen::ProxyDriver"
    assert node["heartbeat_multiplier"] == 20  # 2 s
    assert node["heartbeat_consumer"] is False


# -- budget ----------------------------------------------------------------------------------


def test_budget_lists_every_frame_by_urgency(drives: Robot, files: dict[str, bytes]) -> None:
    (bus,) = json.loads(files["can/budget.json"])["buses"]
    assert bus["load"] == drives.buses[0].load
    rows = bus["frames"]
    assert [r["cob_id"] for r in rows] == sorted(f.cob_id for f in drives.buses[0].frames)
    row = next(r for r in rows if r["name"] == "fl_controller_tpdo1")
    assert (row["bits"], row["period"], row["deadline"]) == (125, 0.02, 0.02)
    assert row["load"] == pytest.approx(125 / 500_000 / 0.02)
    assert 0 < row["transmission_time"] < row["response_time"] < row["deadline"]
    relayed = next(r for r in rows if r["name"] == "sprayer_go")
    assert relayed["minimum_interval"] == pytest.approx(0.1)
    # the rest of the load is one SDO and its answer in a cycle
    counted = sum(r["load"] or 0.0 for r in rows)
    assert bus["load"] == pytest.approx(counted + 2 * 135 / 500_000 / 0.02)


def test_budget_table_is_aligned(files: dict[str, bytes]) -> None:
    text = files["can/budget.md"].decode()
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len({len(row) for row in rows}) == 1
    assert "| 0x183 | fl_controller_tpdo1" in text
    load = json.loads(files["can/budget.json"])["buses"][0]["load"]
    (line,) = (line for line in text.splitlines() if line.startswith("500 kbit/s"))
    worst, below, demand = map(float, re.findall(r"([\d.]+) %", line))
    assert worst == pytest.approx(100 * load, abs=0.05)
    assert worst == pytest.approx(below + demand, abs=0.15)
    column = [row.split("|")[7].strip() for row in rows[2:]]
    shown = sum(float(text) for text in column if text != "-")
    assert below == pytest.approx(shown, abs=0.05 + 0.005 * len(column))


# -- bring-up --------------------------------------------------------------------------------


def stage(tmp_path: Path, files: dict[str, bytes], user: int) -> dict[str, str]:
    """Return a PATH with an ``ip`` that logs its arguments and an ``id`` that prints ``user``."""
    (tmp_path / "bring_up.sh").write_bytes(files["can/bring_up.sh"])
    tools = tmp_path / "tools"
    tools.mkdir()
    for name, text in (("ip", 'echo "$@" >> ip.log'), ("id", f"echo {user}")):
        (tools / name).write_text(f"#!/bin/sh\n{text}\n")
        (tools / name).chmod(0o755)
    return {"PATH": f"{tools}:{os.environ['PATH']}"}


def run(tmp_path: Path, env: dict[str, str], *names: str) -> subprocess.CompletedProcess[str]:
    command = ["sh", "bring_up.sh", *names]
    return subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)


def test_bring_up_sets_the_bitrate_and_never_restarts(
    files: dict[str, bytes], tmp_path: Path
) -> None:
    process = run(tmp_path, stage(tmp_path, files, 0), "lo")  # an interface that every machine has
    assert (process.returncode, process.stderr) == (0, "")
    assert process.stdout == "main: lo, 500000 bit/s\n"
    assert (tmp_path / "ip.log").read_text().splitlines() == [
        "link set dev lo down",
        "link set dev lo type can bitrate 500000 restart-ms 0",
        "link set dev lo txqueuelen 128",
        "link set dev lo up",
    ]


def test_bring_up_reports_errors(files: dict[str, bytes], tmp_path: Path) -> None:
    env = stage(tmp_path, files, 0)
    missing = run(tmp_path, env, "nocan7")
    assert missing.returncode == 3
    assert missing.stderr == "error: there is no interface nocan7 for the bus main\n"
    assert run(tmp_path, env, "lo", "lo").returncode == 2
    (tmp_path / "tools" / "id").write_text("#!/bin/sh\necho 1000\n")
    user = run(tmp_path, env, "lo")
    assert user.returncode == 3
    assert "only root" in user.stderr
    assert not (tmp_path / "ip.log").exists()


def test_bring_up_passes_shellcheck(
    files: dict[str, bytes], tmp_path: Path, shellcheck: str
) -> None:
    path = tmp_path / "bring_up.sh"
    path.write_bytes(files["can/bring_up.sh"])
    subprocess.run([shellcheck, str(path)], check=True)


# -- several buses, none -----------------------------------------------------------------------


def test_several_buses(files: dict[str, bytes], tmp_path: Path) -> None:
    robot = example_robot("4wd4ws_slim")
    second = Bus("implement", 250_000, 0.02, (), (), SPAN)
    emitted = files_of(Can, dataclasses.replace(robot, buses=(*robot.buses, second)))
    assert {"can/main.bus.yml", "can/main.dbc", "can/implement.dbc"} <= set(emitted)
    assert "can/implement.bus.yml" not in emitted  # it has no node for ros2_canopen
    assert [b["name"] for b in json.loads(emitted["can/budget.json"])["buses"]] == [
        "main",
        "implement",
    ]
    process = run(tmp_path, stage(tmp_path, emitted, 0), "lo", "lo")
    assert process.stdout == "main: lo, 500000 bit/s\nimplement: lo, 250000 bit/s\n"


def test_a_robot_without_a_bus_has_only_a_map() -> None:
    assert list(files_of(Can, make_robot(FOUR_STEERED))) == ["can/canmap.json"]
