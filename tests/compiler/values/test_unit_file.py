"""Units of one design: files that name a robot file and state what differs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import CompileError, compile_file, load, load_fleet
from thorvaldc.diagnostics import Report

EXAMPLES = Path(__file__).parents[3] / "examples"
WIDE = EXAMPLES / "4wd4ws_wide/robot.yaml"
HEAD = "thorvaldc: 1\nextends: ../design/robot.yaml\nname: second\n"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a design and a folder for its units, as the working folder."""
    for name in ("design", "units"):
        (tmp_path / name).mkdir()
    (tmp_path / "design/robot.yaml").write_bytes(WIDE.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(text: str, name: str = "units/second.yaml") -> Path:
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def shown(report: Report) -> list[str]:
    """The diagnostics with file and line."""
    return [f"{d.span.file}:{d.span.line} {d.code.name}" for d in report if d.span is not None]


def faults(text: str) -> list[str]:
    return shown(compile_file(write(HEAD + text)).report)


# -- values -----------------------------------------------------------------------------


def test_a_unit_states_what_differs_and_inherits_the_rest() -> None:
    unit = load(write(HEAD + "namespace: r2\nmodules:\n  fl: {params: {gear_ratio: 43:1}}\n"))
    values = {"name": "second", "namespace": "r2", "modules.fl.params.gear_ratio": "43:1"}
    design = load("design/robot.yaml", set=values)
    assert (unit.name, unit.namespace) == ("second", "r2")
    assert [a.gear_ratio for a in unit.actuators] == [a.gear_ratio for a in design.actuators]
    assert [a.gear_ratio for a in unit.actuators].count(43.0) == 1
    assert (unit.inertial, unit.description) == (design.inertial, design.description)


def test_a_key_may_be_the_path_of_a_value_as_in_set() -> None:
    nested = load(write(HEAD + "driver: {rate: 25 Hz}\nmodules: {fl: {can: 7}}\n"))
    dotted = load(write(HEAD + "driver.rate: 25 Hz\n'modules.fl.can': 7\n"))
    assert dotted.driver == nested.driver
    assert [n.id for n in dotted.buses[0].nodes] == [n.id for n in nested.buses[0].nodes]
    assert 7 in [n.id for n in dotted.buses[0].nodes]
    assert not faults("accept.0.reason: chocks are in the box\n")


def test_modules_are_added_and_removed() -> None:
    text = "modules:\n  gnss_aux: null\n  second: {type: sensor/imu, mount: {parent: frame,"
    unit = load(write(HEAD + text + " xyz: [-0.426, 0.1, 0.025]}}\n"))
    assert {"gnss_aux", "second"} & {s.module for s in unit.sensors} == {"second"}
    # In another order, and with the paths of the values.
    text = "modules.second.type: sensor/imu\nmodules.second.mount: gnss_main\n"
    assert faults(text + "modules.gnss_main: null\n")[0].startswith("units/second.yaml:5 ")


def test_a_mapping_replaces_a_port_and_completes_a_short_form() -> None:
    mount = "{parent: frame, xyz: [-0.426, 0.2, 0.025]}"
    text = f"modules: {{gnss_aux: {{mount: {mount}}}}}\nbase_calculator.options.polish: 2\n"
    unit = load(write(HEAD + text))
    assert unit.joint("gnss_aux_mount").pose.xyz[1] == 0.2
    assert unit.calculator.name == "general"


def test_a_serial_number_keeps_the_id_of_the_design() -> None:
    write((EXAMPLES / "lss/robot.yaml").read_text(encoding="utf-8"), "design/robot.yaml")
    design = load("design/robot.yaml")
    node = next(n for n in design.buses[0].nodes if n.serial)
    module = node.module.partition(".")[0]
    unit = load(write(f"{HEAD}modules: {{{module}: {{can: {{serial: '0x4711'}}}}}}\n"))
    after = next(n for n in unit.buses[0].nodes if n.name == node.name)
    assert (after.id, after.serial) == (node.id, "0x4711")


def test_values_of_set_replace_those_of_the_unit() -> None:
    path = write(HEAD + "driver.rate: 25 Hz\n")
    assert load(path, set={"driver.rate": "20 Hz"}).driver.rate == 20.0
    assert load(path, set={"modules.gnss_aux": None}).driver.rate == 25.0
    with pytest.raises(CompileError, match="the design of a unit is read before a value is set"):
        load(path, set={"extends": "other.yaml"})


def test_a_unit_may_be_the_design_of_another() -> None:
    write(HEAD + "driver.rate: 25 Hz\nmodules.gnss_aux: null\n", "units/series.yaml")
    path = write("thorvaldc: 1\nextends: series.yaml\nname: second\nmodules.fl.can: 7\n")
    unit = load(path)
    assert (unit.name, unit.driver.rate) == ("second", 25.0)
    assert "gnss_aux" not in {s.module for s in unit.sensors}
    text = "thorvaldc: 1\nextends: series.yaml\nname: third\nmodules.gnss_aux: null\n"
    assert shown(compile_file(write(text)).report) == ["units/second.yaml:4 variation-path"]


# -- diagnostics ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("driver.rate: 5 kg\n", ["units/second.yaml:4 wrong-dimension"]),
        ("drivr:\n  rate: 5 Hz\n", ["units/second.yaml:4 unknown-key"]),
        ("driver:\n  ratte: 5 Hz\n", ["units/second.yaml:5 unknown-key"]),
        ("modules.fl.params.gear: 43\n", ["units/second.yaml:4 param-unknown"]),
        ("modules.fll.can: 3\n", ["units/second.yaml:4 variation-path"]),
        ("modules:\n  fll: {params: {}}\n", ["units/second.yaml:5 variation-path"]),
        ("modules:\n  gnss_axu: null\n", ["units/second.yaml:5 variation-path"]),
        ("modules:\n  gnss_aux:\n", ["units/second.yaml:5 wrong-type"]),
        (
            "modules: {fl: {can: 7}}\nmodules.fl.can: 8\n",
            ["units/second.yaml:5 yaml-duplicate-key"],
        ),
        ("accept.1.reason: x\n", ["units/second.yaml:4 variation-path"]),
        ("modules..can: 3\n", ["units/second.yaml:4 unknown-key"]),
        ("batteries: parallel\n", ["units/second.yaml:4 unit-unchanged"]),
        ("modules: {frame: {}, fl: {can: 3}}\n", ["units/second.yaml:4 unit-unchanged"]),
        (
            "modules.battery_left.mount.xyz: [0, 0.636, 7 cm]\n",
            ["units/second.yaml:4 unit-unchanged"],
        ),
        ("modules.fl.can: 2\n", ["units/second.yaml:4 can-id-duplicate"]),
        ("modules:\n  battery_left: null\n", ["design/robot.yaml:18 module-unknown"]),
    ],
)
def test_a_mistake_is_named_once_at_its_line(text: str, expected: list[str]) -> None:
    assert faults(text) == expected


def test_a_misspelt_name_gets_a_hint_that_fixes_the_word_alone() -> None:
    for text in ("modules.fll.can: 7\n", "modules: {fll: {can: 7}}\n", "'modules.fll.can': 7\n"):
        (diagnostic,) = compile_file(write(HEAD + text)).report
        (fix,) = diagnostic.fixes
        line = text.splitlines()[0]
        assert diagnostic.span is not None
        word = line[fix.span.column - 1 : fix.span.end_column - 1]
        assert (word, fix.text, fix.span.line) == ("fll", "fl", 4)


def test_a_mistake_of_the_design_is_named_in_its_file() -> None:
    text = WIDE.read_text(encoding="utf-8").replace(
        "design: {slope: 15 deg", "design: {slope: 15 kg"
    )
    write(text, "design/robot.yaml")
    assert faults("driver.rate: 25 Hz\n") == ["design/robot.yaml:5 wrong-dimension"]
    assert faults("design.slope: 15 deg\n") == []


def test_a_unit_needs_a_name_of_its_own() -> None:
    head = "thorvaldc: 1\nextends: ../design/robot.yaml\n"
    report = compile_file(write(head)).report
    assert shown(report) == ["units/second.yaml:1 missing-key"]
    report = compile_file(write(head + "name: thorvald_4wd4ws_wide\n")).report
    assert shown(report) == ["units/second.yaml:3 unit-unchanged"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../design/robt.yaml", "there is no file"),
        ("../design", "there is no file"),
        ("second.yaml", "leads in a circle: second.yaml"),
        ("first.yaml", "leads in a circle: first.yaml -> second.yaml"),
        ("fleet.yaml", "is no robot file"),
        ("lock.yaml", "is no robot file"),
        ("link.yaml", "is a link to a file outside of its folder"),
        ("[]", "expected the file of the design, got a list"),
    ],
)
def test_what_is_no_design_is_an_error_at_extends(name: str, message: str) -> None:
    write("thorvaldc: 1\nextends: second.yaml\nname: first\n", "units/first.yaml")
    write("thorvaldc: 1\nname: f\nrobots: {a: {robot: ../design/robot.yaml}}\n", "units/fleet.yaml")
    write("thorvaldc_lock: 1\naddresses: {}\n", "units/lock.yaml")
    os.symlink("../design/robot.yaml", "units/link.yaml")
    report = compile_file(write(f"thorvaldc: 1\nextends: {name}\nname: second\n")).report
    assert [d.span.line if d.span else 0 for d in report] == [2]
    assert message in str(next(iter(report)).message)


def test_versions_of_unit_and_design_are_both_checked() -> None:
    design = WIDE.read_text(encoding="utf-8")
    write(design.replace("thorvaldc: 1", "thorvaldc: 2"), "design/robot.yaml")
    assert faults("") == ["design/robot.yaml:1 language-version"]
    write(design, "design/robot.yaml")
    report = compile_file(write(HEAD.replace("thorvaldc: 1", "thorvaldc: 2"))).report
    assert shown(report) == ["units/second.yaml:1 language-version"]


def test_a_design_accepts_warnings_at_values_of_its_units() -> None:
    text = WIDE.read_text(encoding="utf-8").replace("code: TV436,", "code: TV436, at: design,")
    write(text, "design/robot.yaml")
    assert faults("design: {slope: 14 deg}\n") == []
    write(text.replace("at: design,", "at: modules.fl,"), "design/robot.yaml")
    assert "slope-not-held" in " ".join(faults("design: {slope: 14 deg}\n"))


# -- files ------------------------------------------------------------------------------


def test_a_path_is_relative_to_the_file_that_states_it() -> None:
    design = WIDE.read_text(encoding="utf-8").replace(
        "modules:\n", "library: [parts]\nmodules:\n", 1
    )
    module = (
        "thorvaldc: 1\ndescription: A box.\nmount: {kinds: [frame_clamp], link: box}\nlinks: {box: "
    )
    module += "{parts: [{shape: {box: [0.1, 0.1, 0.1]}, mass: 1 kg, source: 'measured: scale'}]}}\n"
    write(module, "design/parts/my/box/module.yaml")
    mast = (
        "<robot><link name='mast'><inertial><mass value='1'/><inertia ixx='0.1' iyy='0.1' izz='0.1'"
    )
    mast += " ixy='0' ixz='0' iyz='0'/></inertial></link></robot>\n"
    write(mast, "design/mast.urdf")
    extras = "extras: [{xacro: mast.urdf, parent: frame}]\ncalibration: wheels.yaml\n"
    wheels = "thorvaldc: 1\nrobot: {}\nwheels: {{fl_wheel: {{radius: {} mm}}}}\n"
    write(wheels.format("second", 201), "design/wheels.yaml")
    write(wheels.format("second", 199), "units/wheels.yaml")
    write(design + "  \n" + extras, "design/robot.yaml")
    text = "modules: {box: {type: my/box, mount: frame.front_center}}\n"
    for path, robot in (("design", load(write(HEAD + text))), ("units", None)):
        robot = robot or load(write(HEAD + text + "calibration: ./wheels.yaml\n"))
        radius = {"design": 0.201, "units": 0.199}[path]
        assert {w.name: w.radius for w in robot.wheels}["fl_wheel"] == radius
        assert {"mast", "box_box"} <= {link.name for link in robot.links}


def test_a_fleet_names_units_and_outputs_do_not_depend_on_the_place_of_the_folder() -> None:
    write(HEAD + "driver.rate: 25 Hz\n")
    fleet = write(
        "thorvaldc: 1\nname: pair\nrobots:\n  a: {robot: design/robot.yaml}\n"
        "  b: {robot: units/second.yaml, xyz: [0, 4, 0]}\n",
        "fleet.yaml",
    )
    rates = {p.name: p.robot.driver.rate for p in load_fleet(fleet).placements}
    assert rates == {"a": 50.0, "b": 25.0}
    spans = {link.span.file for link in load("units/second.yaml").links}
    assert not any(os.path.isabs(name) for name in spans)


def test_the_hash_of_the_inputs_contains_the_design() -> None:
    path = write(HEAD)
    hashes = {compile_file(path).source_sha256}
    Path("design/robot.yaml").write_bytes(WIDE.read_bytes() + b"# changed\n")
    hashes.add(compile_file(path).source_sha256)
    hashes.add(compile_file(write(HEAD + "driver.rate: 25 Hz\n")).source_sha256)
    assert len(hashes) == 3


def test_a_unit_pins_the_ids_of_its_design_in_its_own_lock_file() -> None:
    text = WIDE.read_text(encoding="utf-8").replace(", can: 3}", "}")
    write(text, "design/robot.yaml")
    lock = "thorvaldc_lock: 1\naddresses: {main: {canopen: {fl.controller: 9}}}\n"
    write(lock, "design/robot.lock.yaml")
    compilation = compile_file(write(HEAD))
    assert [path.name for path in compilation.locks] == ["second.lock.yaml"]
    assert "fl.controller: 9" in next(iter(compilation.locks.values()))
    write(lock.replace("9", "10"), "units/second.lock.yaml")
    nodes = {node.name: node.id for node in load("units/second.yaml").buses[0].nodes}
    assert nodes["fl_controller"] == 10
