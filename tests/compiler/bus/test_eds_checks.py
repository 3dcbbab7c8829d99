"""A module that names the EDS of its device: contradictions, each at the line that states it."""

from __future__ import annotations

from pathlib import Path

import pytest

import thorvaldc
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Diagnostic

ROBOT = """\
thorvaldc: 1
name: r
library: [lib]
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: caster/fixed, mount: frame.front_left}
  fr: {type: caster/fixed, mount: frame.front_right}
  rear: {type: caster/swivel, mount: frame.rear_center}
  one: {type: my/device, can: {id: 5, serial: "0x77"}}
  two: {type: my/device, can: 6}
"""
MODULE = """\
thorvaldc: 1
description: A device of my own.
can:
  protocol: mine
  eds: mine.eds
  vendor_id: 0x123
  product_code: 0x45
  device_type: 0x20191
  canopen: [sdo, heartbeat, emcy]
  heartbeat_period: 250 ms
  heartbeat_consumer_time: 500 ms
  objects:
    limit: {index: 0x2000, type: unsigned16, value: 100}
    angle: {index: 0x2001, subindex: 2, type: integer16, value: -100}
    fixed: {index: 0x2002, type: unsigned8, value: 3}
    switch: {index: 0x2003, type: boolean, value: 1}
  frames:
    rpdo1:
      cob_id: "${0x200 + id}"
      kind: pdo
      pdo: 1
      mapping:
        - [0x0005, 0, unsigned8]
        - [0x3000, 0, unsigned8]
      synchronous: true
      direction: command
      length: 2
      period: cycle
    tpdo1:
      cob_id: "${0x180 + id}"
      kind: pdo
      pdo: 1
      mapping:
        - [0x3001, 0, integer32]
      direction: report
      length: 4
      period: 100 ms
"""
# Index, access, data type, value, and further keys: m mappable, <lower limit, >upper limit.
OBJECTS = """\
1000 ro 7 0x20191
1001 ro 5 0
1005 rw 7 0x80
1014 rw 7 $NODEID+0x80 <$NODEID+0x80 >$NODEID+0x80
1016sub1 rw 7 0
1017 rw 6 0
1018sub1 ro 7 0x123
1018sub2 ro 7 0x45
1018sub4 ro 7 0
1400sub1 ro 7 $NODEID+0x200
1400sub2 rw 5 255
1600sub0 const 5 2
1600sub1 const 7 0x00050008
1600sub2 const 7 0x30000008
1800sub1 rw 7 $NODEID+0x180
1800sub2 rw 5 255
1800sub5 rw 6 0
1A00sub0 rw 5 0
1A00sub1 rw 7 0
2000 rw 6 0 <10 >1000
2001sub2 rw 3 0 <0xFF00 >0
2002 ro 5 3 <0 >0
2003 rw 5 0
3000 rww 5 0 m
3001 ro 4 0 m
"""


def eds(objects: str) -> str:
    """Returns the text of an EDS."""
    lines = ["[DeviceInfo]", "VendorName=Example"]
    for row in objects.splitlines():
        section, access, kind, *more = row.split()
        keys = {"ParameterName": section, "AccessType": access, "DataType": f"0x{kind}"}
        keys["PDOMapping"] = str(int("m" in more))
        for text in more:
            name = {"<": "LowLimit", ">": "HighLimit", "m": ""}.get(text[0], "DefaultValue")
            keys |= {name: text.lstrip("<>")} if name else {}
        lines += [f"[{section}]", *(f"{key}={value}" for key, value in keys.items())]
    return "\n".join(lines) + "\n"


def check(folder: Path, module: str = MODULE, objects: str = OBJECTS) -> list[Diagnostic]:
    """Returns the errors of the robot, whose devices have the module and its EDS."""
    own = folder / "lib/my/device"
    own.mkdir(parents=True)
    (own / "mine.eds").write_text(eds(objects), encoding="utf-8")
    (own / "module.yaml").write_text(module, encoding="utf-8")
    (folder / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    return thorvaldc.compile(folder / "robot.yaml").report.errors


def test_a_module_that_agrees_with_its_eds(tmp_path: Path) -> None:
    assert check(tmp_path) == []
    compilation = compile_file(tmp_path / "robot.yaml")
    assert any(name.endswith("lib/my/device/mine.eds") for name in compilation.files)


CONFLICTS = [
    # old and new text of the objects; the line of the module; the message.
    ("2000 rw 6", "2F00 rw 6", "    limit:", "has no object 0x2000, which `limit` needs"),
    ("2001sub2", "2001sub3", "    angle:", "has no object 0x2001:2, which `angle` needs"),
    ("ro 5 3", "ro 5 4", "    fixed:", "`fixed` cannot be written (`ro`) and has the value 4; 3"),
    ("ro 5 3", "ro 5", "    fixed:", "`fixed` cannot be written (`ro`); 3 is required"),
    ("2000 rw 6", "2000 rw 7", "    limit:", "of `limit` is unsigned32, not unsigned16"),
    ("2000 rw 6", "2000 rw 8", "    limit:", "is of the data type 0x0008, not unsigned16"),
    ("<10 >1000", "<101", "    limit:", "must be at least 101 (0x65), not 100 (0x64)"),
    ("<10 >1000", "<10 >99", "    limit:", "must be at least 10 (0xa) and at most 99 (0x63), not"),
    ("<0xFF00", "<0xFFF0", "    angle:", "must be at least -16 and at most 0, not -100"),
    ("ro 7 0x123", "ro 7 0x124", "  vendor_id:", "is 292 (0x124), not 291 (0x123)"),
    ("ro 7 0x20191", "ro 7 0x20192", "  device_type:", "is 131474 (0x20192), not"),
    ("1018sub2", "1018sub3", "  product_code:", "has no object 0x1018:2"),
    ("1018sub4 ro 7 0\n", "", 'serial: "0x77"', "has no object 0x1018:4"),
    ("1014 rw", "1015 rw", "  canopen:", "has no object 0x1014, which `emcy_cob_id` needs"),
    ("1017 rw 6 0", "1017 rw 6 0 >99", "  heartbeat_period:", "must be at most 99 (0x63), not 250"),
    ("1016sub1", "1016sub2", "  heartbeat_consumer_time:", "has no object 0x1016:1"),
    ("1005 rw", "1006 rw", "      synchronous:", "has no object 0x1005"),
    ("$NODEID+0x200", "$NODEID+0x300", "    rpdo1:", "has the value 773 (0x305); 517 (0x205)"),
    ("0x30000008", "0x30010008", "    rpdo1:", "`rpdo1_mapping_2` cannot be written (`const`)"),
    ("1800sub5", "1800sub3", "    tpdo1:", "has no object 0x1800:5"),
    ("3000 rww", "3F00 rww", "        - [0x3000", "has no object 0x3000, which the RPDO 1 needs"),
    ("3000 rww", "3000 rwr", "        - [0x3000", "a PDO of this direction (`rwr`)"),
    ("3001 ro", "3001 rww", "        - [0x3001", "a PDO of this direction (`rww`)"),
    ("3001 ro 4 0 m", "3001 ro 4 0", "        - [0x3001", "TPDO 1 cannot be in a PDO"),
    ("3001 ro 4", "3001 ro 7", "        - [0x3001", "is unsigned32, not integer32"),
]


@pytest.mark.parametrize(("old", "new", "line", "message"), CONFLICTS)
def test_a_contradiction_stands_once_at_its_line(
    tmp_path: Path, old: str, new: str, line: str, message: str
) -> None:
    assert OBJECTS.count(old) == 1
    objects = OBJECTS.replace(old, new)
    error, *others = check(tmp_path, objects=objects)
    assert bool(others) is ("(0x205)" in message)  # the value of the other device is another one
    assert error.code.name == "can-eds-conflict"
    assert message in error.message
    assert error.span is not None
    assert error.hint
    shown = Path(error.span.file).read_text(encoding="utf-8").splitlines()
    assert line in shown[error.span.line - 1]
    for label in error.labels:
        if label.span.file.endswith(".eds"):
            section = eds(objects).splitlines()[label.span.line - 1].strip("[]")
            assert section[:4] == error.message.partition("0x")[2][:4]


def test_the_eds_has_the_path_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    error, *_ = check(Path(), objects=OBJECTS.replace("2000 rw 6", "2F00 rw 6"))
    assert error.span is not None
    files = {error.span.file, *(label.span.file for label in error.labels)}
    assert not any(Path(file).is_absolute() for file in files)


def test_a_pdo_that_the_device_does_not_have_is_two_errors(tmp_path: Path) -> None:
    objects = OBJECTS.replace("1800sub", "1801sub").replace("1A00sub", "1A01sub")
    errors = check(tmp_path, objects=objects)
    assert [error.message.partition("mine.eds")[2] for error in errors] == [
        "` has no object 0x1800, which `tpdo1_cob_id` needs",
        "` has no object 0x1A00, which `tpdo1_mapped_objects` needs",
    ]


def test_a_device_with_lss_reports_its_whole_identity(tmp_path: Path) -> None:
    module = MODULE.replace("  product_code", "  revision_number: 1\n  lss: true\n  product_code")
    objects = OBJECTS.replace("1018sub4 ro 7 0", "1018sub3 ro 7 1")
    with_serial = objects.replace("1400sub1", "1018sub4 ro 7\n1400sub1")
    assert check(tmp_path / "a", module, with_serial) == []
    of_robot, error = check(tmp_path / "b", module, objects)
    assert "has no object 0x1018:4, which `serial_number` needs" in error.message
    assert error.span is not None
    assert module.splitlines()[error.span.line - 1] == "  lss: true"
    assert of_robot.span is not None
    assert of_robot.span.file.endswith("robot.yaml")


def test_a_tpdo_without_an_event_timer_needs_none(tmp_path: Path) -> None:
    module = MODULE.replace("period: 100 ms", "period: on_demand")
    assert check(tmp_path, module, OBJECTS.replace("1800sub5 rw 6 0\n", "")) == []
    robot = thorvaldc.compile(tmp_path / "robot.yaml").model
    assert robot is not None
    for node in robot.buses[0].nodes:
        assert [o.subindex for o in node.objects if o.index == 0x1800] == [1, 2]


@pytest.mark.parametrize(
    ("file", "code"),
    [
        ("mines.eds", "file-not-found"),
        ("module.yaml", "unknown-value"),
        ("../mine.eds", "unknown-value"),
    ],
)
def test_an_eds_is_a_file_beside_the_module(tmp_path: Path, file: str, code: str) -> None:
    (error,) = check(tmp_path, MODULE.replace("mine.eds", file))
    assert error.code.name == code
    assert str(error.span).endswith("lib/my/device/module.yaml:5:8")


def test_an_eds_with_an_error_is_reported_at_its_line(tmp_path: Path) -> None:
    (error,) = check(tmp_path, objects=OBJECTS.replace("1001 ro 5 0", "1001 ro 5 zero"))
    assert error.code.name == "file-unreadable"
    assert str(error.span).endswith("lib/my/device/mine.eds:9:1")


def test_an_eds_outside_of_the_library_is_not_read(tmp_path: Path) -> None:
    assert check(tmp_path) == []
    file = tmp_path / "lib/my/device/mine.eds"
    file.rename(tmp_path / "mine.eds")
    file.symlink_to(tmp_path / "mine.eds")
    (error,) = thorvaldc.compile(tmp_path / "robot.yaml").report.errors
    assert "a link to a file outside of its folder" in error.message
