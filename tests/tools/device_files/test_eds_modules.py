"""Modules from EDS and DCF files: identity, PDOs and drives that run on the simulated bus."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.devices import Bench
from thorvaldc.model import Bus

HERE = Path(__file__).parent
IO = (HERE / "io.eds").read_text(encoding="utf-8")
DRIVE = (HERE / "drive.eds").read_text(encoding="utf-8")
ROBOT = """\
thorvaldc: 1
name: rover
base_calculator: differential
library: [modules]
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, cross_members: [0]}}
  left: {type: assembly/fixed_drive, mount: frame.front_left}
  right: {type: assembly/fixed_drive, mount: frame.front_right}
  one:
    type: controller/mine
    params: {velocity_unit: 1 rpm}
    channels: {motor: left.propulsion}
    can: 1
  two: {type: controller/cia402_propulsion, channels: {propulsion: right.propulsion}, can: 2}
  io: {type: io/mine, mount: {parent: frame, xyz: [0.3, 0, 0.1]}, can: auto}
  caster_left: {type: caster/swivel, mount: frame.rear_left}
  caster_right: {type: caster/swivel, mount: frame.rear_right}
  battery:
    type: battery/enclosure
    mount: {parent: frame, xyz: [0, 0, 0.07], rpy: [0, 0, 90 deg]}
    can: 1
"""


def import_device(command: Command, type_name: str, text: str) -> tuple[str, str]:
    """Runs the command, and returns the text of the module and the messages."""
    Path("mine.eds").write_text(text, encoding="cp1252")
    made = command("modules", "from-eds", type_name, "mine.eds")
    assert made.status == 0, made.err
    return Path(f"modules/{type_name}/module.yaml").read_text(encoding="utf-8"), made.err


def bus_of(text: str, node_id: int = 5) -> Bus:
    bench = Bench()
    bench.add("my/device", node_id, text=re.sub(r"  eds: .*\n", "", text))
    (bus,) = bench.build()
    assert not list(bench.report)
    return bus


def test_an_io_device_has_the_pdos_and_the_identity_of_its_file(thorvaldc: Command) -> None:
    text, messages = import_device(thorvaldc, "io/mine", IO)
    bus = bus_of(text)
    (node,) = bus.nodes
    assert (node.vendor_id, node.product_code, node.revision_number) == (0x123, 0x45, 0x10002)
    assert (node.device_type, node.id_space, node.lss) == (0x30191, "canopen", False)
    assert node.bitrates == (125_000, 250_000, 500_000, 1_000_000)
    assert node.heartbeat_consumer_time == 0.5
    frames = {frame.name: frame for frame in bus.frames if frame.producer != "master" or frame.pdo}
    assert {name: (f.cob_id, f.period, f.length, f.synchronous) for name, f in frames.items()} == {
        "d1_rpdo1": (0x205, None, 3, False),
        "d1_tpdo1": (0x185, 0.04, 2, False),
        "d1_tpdo2": (0x285, 0.02, 4, True),
        "d1_sdo_response": (0x585, None, 8, False),
        "d1_heartbeat": (0x705, 0.25, 1, False),
        "d1_emcy": (0x85, None, 8, False),
    }
    assert frames["d1_tpdo1"].mapping == ((0x6000, 1, "unsigned8"), (0x6000, 2, "unsigned8"))
    outputs, analogue = frames["d1_rpdo1"].signals
    assert (outputs.name, outputs.minimum, outputs.maximum) == ("outputs_1_to_8", 0.0, 15.0)
    assert (analogue.start, analogue.length, analogue.signed) == (8, 16, True)
    assert "# 0x1018:1" in text
    assert "0x6411:1, Write Analogue Output Output 1." in text
    assert dict(re.findall(r"the PDO of the object (0x\w+) is left out: (.*)", messages)) == {
        "0x1401": "it is not used (bit 31 of its COB-ID, 0x1401:1)",
        "0x1802": "0x2000:0 has 32 bits and a type that a module does not have",
    }


def battery_eds(profile: int) -> str:
    """The file of a battery of CiA 418, or charger of CiA 419, with two reports."""
    objects = {0x6010: 3, 0x6051: 6, 0x6060: 7, 0x6070: 6, 0x6081: 5}  # index and data type
    lengths = {3: 16, 5: 8, 6: 16, 7: 32}
    values = {(0x1000, 0): profile, (0x1001, 0): 0, (0x1017, 0): 500}
    for number, mapped in enumerate(([0x6060, 0x6010, 0x6081], [0x6051, 0x6070])):
        values[0x1800 + number, 0] = 5
        values[0x1800 + number, 1] = 0x185 + 0x100 * number
        values[0x1800 + number, 5] = 100
        values[0x1A00 + number, 0] = len(mapped)
        for place, index in enumerate(mapped, 1):
            values[0x1A00 + number, place] = index << 16 | lengths[objects[index]]
    lines = ["[DeviceComissioning]", "NodeID=5"]
    for (index, subindex), value in values.items():
        name = f"{index:X}sub{subindex:X}" if index & 0xFFF0 in (0x1800, 0x1A00) else f"{index:X}"
        if subindex == 0 and "sub" in name:
            lines += [f"[{index:X}]", "ParameterName=PDO", "ObjectType=9"]
        lines += [f"[{name}]", "ParameterName=Entry", "ObjectType=7", "DataType=7"]
        lines += ["AccessType=rw", f"DefaultValue={value}"]
    for index, kind in objects.items():
        lines += [f"[{index:X}]", f"ParameterName=Object {index:X}", f"DataType={kind}"]
        lines += ["ObjectType=7", "AccessType=ro", "PDOMapping=1"]
    return "\n".join(lines) + "\n"


def test_a_battery_and_its_charger_have_the_units_of_their_profiles(thorvaldc: Command) -> None:
    text, messages = import_device(thorvaldc, "battery/mine", battery_eds(418))
    assert "left out" not in messages
    values = {
        signal.name: (signal.unit, signal.scale * raw)
        for frame in bus_of(text).frames
        for signal, raw in zip(frame.signals, (48 * 1024, 200, 75), strict=False)
        if frame.name in ("d1_tpdo1", "d1_tpdo2")
    }
    assert values["voltage"] == ("V", 48.0)
    assert values["temperature"] == ("degC", 25.0)
    assert values["state_of_charge"] == ("%", 75.0)
    assert values["requested_charge_current"] == ("A", 12.5)
    assert values["object_6051"] == ("Ah", 6144.0)
    assert "battery: {present: true, link: housing}" in text
    assert "# CiA 418 has no current of the battery" in text
    text, _ = import_device(thorvaldc, "charger/mine", battery_eds(419))
    units = {s.name: s.unit for f in bus_of(text).frames for s in f.signals}
    assert (units["object_6060"], units["object_6081"]) == ("V", "%")
    assert "battery:" not in text


def test_analogue_values_of_cia_401_have_no_unit_that_the_file_knows(thorvaldc: Command) -> None:
    text, _ = import_device(thorvaldc, "io/mine", IO)
    assert "# CiA 401 gives analogue values no unit: state `unit` and `scale`" in text
    assert {s.unit for f in bus_of(text).frames for s in f.signals} == {""}
    text, _ = import_device(thorvaldc, "io/other", battery_eds(401))
    assert "CiA 401 gives" not in text


def test_a_robot_with_devices_of_their_eds_is_scanned(thorvaldc: Command) -> None:
    """New devices have the identity of their file, and need ids; flashed ones have those."""
    import_device(thorvaldc, "controller/mine", DRIVE)
    import_device(thorvaldc, "io/mine", IO)
    Path("robot.yaml").write_text(ROBOT, encoding="utf-8")
    flash = "can flash robot.yaml --bus virtual:delivered --store store.json --apply --yes"
    scan = "can scan robot.yaml --bus virtual"
    delivered = json.loads(thorvaldc(*f"{scan}:delivered --json".split()).out)
    verdicts = {node["node"]: node["verdict"] for node in delivered["nodes"]}
    assert verdicts == {"one": "missing", "two": "missing", "io": "ok", "battery": "ok"}
    assert thorvaldc(*flash.split()).status == 0
    flashed = thorvaldc(*f"{scan} --store store.json --active --json".split())
    assert flashed.status == 0, flashed.err
    nodes = {node["node"]: node for node in json.loads(flashed.out)["nodes"]}
    assert {node["verdict"] for node in nodes.values()} == {"ok"}
    for name, device_type in (("one", 0x20192), ("io", 0x30191)):
        assert nodes[name]["identity"][:3] == [0x123, 0x45, 0x10002]
        assert nodes[name]["device_type"] == device_type


def test_a_robot_of_three_brands_is_flashed_and_drives(thorvaldc: Command) -> None:
    text, _ = import_device(thorvaldc, "controller/mine", DRIVE)
    assert "# The drive has no writable 0x605E (fault_reaction_option): set it there." in text
    assert "choices: [3, 9]" in text
    import_device(thorvaldc, "io/mine", IO)
    Path("robot.yaml").write_text(ROBOT, encoding="utf-8")
    for arguments in (["modules", "check", "modules"], ["check", "robot.yaml"]):
        checked = thorvaldc(*arguments)
        assert (checked.status, checked.err) == (0, ""), checked.out
    before = thorvaldc(*["can", "verify", "robot.yaml", "--bus", "virtual:delivered"])
    assert "io       1016:1 heartbeat_consumer_time" in before.out  # a device of its EDS alone
    flash = "can flash robot.yaml --bus virtual:delivered --store store.json --apply --yes"
    for command in (flash, "can verify robot.yaml --bus virtual --store store.json"):
        written = thorvaldc(*command.split())
        assert written.status == 0, written.out + written.err
    drive = "run robot.yaml --bus virtual --fast --twist 0.5,0,0 --duration 3"
    run = thorvaldc(*drive.split())
    assert run.status == 0, run.err
    assert re.search(r" 1\.[3-6] 0\.0 m 0 deg", run.out), run.out


def test_a_device_without_a_simulation_of_its_own_gets_no_id(thorvaldc: Command) -> None:
    import_device(thorvaldc, "io/mine", IO)
    module = Path("modules/io/mine/module.yaml")
    text = module.read_text(encoding="utf-8")
    module.write_text(re.sub(r"  eds: .*\n", "", text), encoding="utf-8")
    part = "  box: {type: io/mine, mount: {parent: frame, xyz: [0.3, 0, 0.1]}, can: 9}\n"
    drives = f"library: [modules]\n{GOOD}{part}"
    Path("rover.yaml").write_text(drives, encoding="utf-8")
    flash = ["can", "flash", "rover.yaml", "--bus", "virtual:delivered", "--yes", "--apply"]
    outcome = thorvaldc(*flash)
    assert outcome.status == 3, outcome.err
    assert "set the id" in outcome.err
    assert "the operator declined the step" in outcome.err


def test_the_unit_of_the_velocity_must_be_stated(thorvaldc: Command) -> None:
    import_device(thorvaldc, "controller/mine", DRIVE)
    import_device(thorvaldc, "io/mine", IO)
    Path("robot.yaml").write_text(
        ROBOT.replace("    params: {velocity_unit: 1 rpm}\n", ""), encoding="utf-8"
    )
    checked = thorvaldc("check", "robot.yaml")
    assert checked.status == 1
    assert "param-missing" in checked.out
    assert "`velocity_unit`" in checked.out


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("[60FF]", "[60FE]", "0x60FF (missing)"),
        ("Velocity actual value\nObjectType=0x7\nDataType=0x0004", "V\nDataType=3", "(integer16)"),
        ("0x00000185", "0x00000001", "0x6502 (neither mode 3 nor 9)"),
        ("=Entry 1\nObjectType=0x7\nDataType=0x0007\nAccessType=rw", "=E\nDataType=7", "0x1600"),
        ("[1005]", "[1006]", "0x1005 (missing)"),
    ],
)
def test_a_drive_that_the_driver_cannot_use_keeps_its_pdos(
    thorvaldc: Command, old: str, new: str, reason: str
) -> None:
    text, _ = import_device(thorvaldc, "controller/mine", DRIVE.replace(old, new))
    assert re.search(rf"# The driver `cia402` cannot drive it: .*{re.escape(reason)}", text)
    assert "protocol: mine" in text
    torque = next(s for f in bus_of(text).frames for s in f.signals if "torque" in s.name)
    assert (torque.unit, torque.scale) == ("%", 0.1)


def test_a_dcf_is_of_one_node_and_its_values_come_first(thorvaldc: Command) -> None:
    dcf = IO.replace("DefaultValue=$NODEID+0x180", "DefaultValue=1\nParameterValue=0x189")
    text, _ = import_device(thorvaldc, "io/mine", dcf + "\n[DeviceComissioning]\nNodeID=9\n")
    assert "cob_id: ${0x180 + id}  # 0x1800:1" in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (IO.replace("[1000]", "[100]"), "mine.eds:1:1: error[TV903]"),
        (IO.replace("[1001]\n", "[1001]\nnonsense\n"), "mine.eds:27:1: error[TV903]"),
        (IO.replace("[1001]", "[1000]"), "mine.eds:26:1: error[TV903]"),
        (IO.replace("0x30191", "three"), "`three` is not a whole number"),
        (IO.replace("CompactSubObj=2", "CompactSubObj=99999999"), "1 to 254 entries"),
        (IO.replace("NODEID+0x80", "NODEID+0x800000"), ""),
        (IO.replace("DefaultValue=2\n", "DefaultValue=0xFFFFFFFF\n"), ""),
        ("no section\n", "mine.eds:1:1: error[TV903]"),
        ("[1000]\nDataType=7\n", "error[TV932]"),
        ("", "error[TV903]"),
    ],
    ids=["type", "line", "twice", "number", "compact", "emcy", "count", "text", "no PDO", "empty"],
)
def test_broken_files(thorvaldc: Command, text: str, message: str) -> None:
    Path("mine.eds").write_text(text, encoding="utf-8")
    made = thorvaldc("modules", "from-eds", "io/mine", "mine.eds")
    assert made.status == (1 if message else 0), made.err
    assert message in made.err
