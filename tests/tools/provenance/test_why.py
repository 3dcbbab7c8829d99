"""``thorvaldc why``, as its users call it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Command
from tests.examples import example_robot
from thorvaldc.comparison.robot_difference import field_unit
from thorvaldc.model.facts.robot_facts import fact_sections, json_value
from thorvaldc.tools.provenance.explanation import FACTS
from thorvaldc.tools.provenance.value_names import values_of

SMALL = """\
thorvaldc: 1
name: small
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: 1}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: 2}
  rl: {type: caster/swivel, mount: frame.rear_left}
  rr: {type: caster/swivel, mount: frame.rear_right}
"""
CALIBRATION = """\
thorvaldc: 1
robot: small
wheels:
  fl_wheel: {radius: 0.199}
"""
# An assembly in an assembly, and a value that passes through both.
OUTER = """\
thorvaldc: 1
description: A mast with a sensor on it.
category: mast
params:
  height: {quantity: length, default: 1.2 m, description: Height, source: "chosen: a test"}
let:
  half: ${height / 2}
modules:
  pole: {type: mast/pole, params: {height: "${2 * half}"}}
  imu: {type: sensor/imu, mount: {parent: pole, xyz: [0, 0, "${half}"]}}
"""
POLE = """\
thorvaldc: 1
description: A pole.
category: mast
params:
  height: {quantity: length, default: 1 m, description: Height, source: "chosen: a test"}
mount: {kinds: [frame_clamp, sensor_mount], link: body}
free_mount: {kind: sensor_mount, link: body}
links:
  body:
    parts:
      - shape: {box: [50 mm, 50 mm, "${height}"]}
        mass: ${height * 2 kg/m}
        source: "measured: 2 kg for each metre"
"""


@pytest.fixture(autouse=True)
def _small_robot(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SMALL, encoding="utf-8")


def explained(thorvaldc: Command, path: str, file: str = "small.yaml") -> dict[str, Any]:
    result = thorvaldc("why", file, path, "--json")
    assert result.status == 0, result.err
    return dict(json.loads(result.out))


def sources(document: dict[str, Any]) -> list[str]:
    return [place["key"] for place in (*document["comes_from"], *document["through"])]


def test_the_default_of_a_module_that_another_module_chooses(thorvaldc: Command) -> None:
    result = thorvaldc("why", "small.yaml", "wheels.fl.radius")
    assert result.status == 0
    lines = result.out.splitlines()
    assert lines[0] == "wheels.fl_wheel.radius = 0.2 m"
    assert "fl.wheel at small.yaml:5:3" in lines[1]
    assert "params.radius.default: 200 mm" in result.out
    assert "published: configuration files of the original, r_wheel" in result.out
    assert "wheel.radius: ${radius}" in result.out
    assert "params.wheel.default: wheel/agri_200" in result.out
    uses = result.out.partition("goes into")[2]
    assert "mjcf/robot.xml" in uses
    assert max(map(len, lines)) <= 80


def test_a_sum_comes_from_its_terms(thorvaldc: Command) -> None:
    keys = sources(explained(thorvaldc, "mass"))
    assert "modules.frame.params.width" in keys
    assert len([key for key in keys if key.endswith(("mass", "mass.default"))]) > 5


def test_a_limit_that_the_robot_file_states(thorvaldc: Command) -> None:
    text = SMALL + "driver: {max_linear_velocity: 1 m/s}\n"
    Path("limited.yaml").write_text(text, encoding="utf-8")
    document = explained(thorvaldc, "limits.linear_velocity", "limited.yaml")
    assert sources(document) == ["driver.max_linear_velocity"]


def test_a_fact(thorvaldc: Command) -> None:
    document = explained(thorvaldc, "size.track")
    assert "modules.frame.params.width" in sources(document)
    assert document["unit"] == "m"


@pytest.mark.parametrize("name", ["car", "2wd0ws_greenhouse"])
def test_every_fact_with_a_dimension_has_a_unit(name: str) -> None:
    without = set()
    for part in FACTS:
        facts = json_value(fact_sections(example_robot(name), [part])[part])
        for path, (value, *_) in values_of({part: facts}):
            is_number = isinstance(value, float) or (isinstance(value, list) and bool(value))
            if is_number and not field_unit(tuple(path.split("."))):
                without.add(re.sub(r"\.\d+$", "", path))
    # The others are lists of names and of objects.
    ratios = {"slopes.friction", "slopes.rolling_resistance"}
    assert without <= {*ratios, "energy.missing", "energy.batteries"}


def test_a_node_id(thorvaldc: Command) -> None:
    document = explained(thorvaldc, "nodes.fl.id")
    assert sources(document) == ["modules.fl.can"]
    assert document["module_types"][0]["key"] == "modules.fl.type"
    assert {"can/canmap.json", "can/robot.dbc", "can/dcf/fl_controller.dcf"} <= set(
        document["goes_into"]
    )


def test_a_calibration_file(thorvaldc: Command) -> None:
    Path("calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    text = SMALL.replace("name: small", "name: small\ncalibration: calibration.yaml")
    Path("measured.yaml").write_text(text, encoding="utf-8")
    document = explained(thorvaldc, "wheels.fl.radius", "measured.yaml")
    assert sources(document) == ["wheels.fl_wheel.radius"]
    assert document["comes_from"][0]["place"].startswith("calibration.yaml:4:")


@pytest.mark.slow
def test_an_assembly_in_a_module_folder_of_the_user(thorvaldc: Command) -> None:
    for name, module in (("tower", OUTER), ("pole", POLE)):
        folder = Path("parts/mast") / name
        folder.mkdir(parents=True)
        (folder / "module.yaml").write_text(module, encoding="utf-8")
    text = SMALL.replace("name: small", "name: small\nlibrary: [parts]") + (
        "  tower: {type: mast/tower, mount: {parent: frame, xyz: [0, 0, 0.1]},"
        " params: {height: 1.4 m}}\n"
    )
    Path("tall.yaml").write_text(text, encoding="utf-8")
    document = explained(thorvaldc, "modules.tower.pole.params.height", "tall.yaml")
    assert document["value"] == pytest.approx(1.4)
    assert document["unit"] == "m"
    assert sorted(sources(document)) == [
        "let.half",
        "modules.pole.params.height",
        "modules.tower.params.height",
    ]
    mass = explained(thorvaldc, "links.tower_pole_body.mass", "tall.yaml")
    assert mass["value"] == pytest.approx(2.8)
    assert "modules.tower.params.height" in sources(mass)
    assert [place["key"] for place in mass["module_types"]] == [
        "modules.tower.type",
        "modules.pole.type",
    ]


def test_a_line_of_an_output(thorvaldc: Command) -> None:
    assert thorvaldc("build", "small.yaml", "-o", "out").status == 0
    lines = Path("out/urdf/robot.urdf").read_text(encoding="utf-8").splitlines()
    number = next(n for n, line in enumerate(lines, 1) if "<mass" in line)
    document = explained(thorvaldc, f"out/urdf/robot.urdf:{number}")
    assert document["name"] == f"urdf/robot.urdf:{number}"
    assert document["value"] == lines[number - 1].strip()
    assert "modules.frame.params.width" in sources(document)
    text = Path("out/mjcf/scene.xml").read_text(encoding="utf-8")
    number = text[: text.index("extent=")].count("\n") + 1
    assert sources(explained(thorvaldc, f"mjcf/scene.xml:{number}"))


def test_a_line_of_the_robot_file_names_its_places_in_all_targets(thorvaldc: Command) -> None:
    document = explained(thorvaldc, "small.yaml:4")  # the frame
    assert sources(document)[1:] == ["modules.frame.params.length", "modules.frame.params.width"]
    assert "links.frame_body.inertial.mass" in document["goes_into_the_model"]
    uses = document["goes_into"]
    assert {"urdf/robot.urdf", "mjcf/robot.xml", "ros2/urdf/robot.urdf"} <= set(uses)
    assert any("frame_body" in line for line in uses["urdf/robot.urdf"].values())
    library = explained(thorvaldc, "<library>/wheel/agri_200/module.yaml:6")
    assert "wheels.fl_wheel.radius" in library["goes_into_the_model"]


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("wheels.fl.radios", "did you mean `radius`?"),
        ("whels.fl.radius", "did you mean `wheels`?"),
        ("modules.frame.params.widht", "did you mean `width`?"),
        ("modules.fram.params.width", "did you mean `frame`?"),
        ("wheels.fl", "known: wheels.fl_wheel."),
        ("stability.angles", "known: stability.angles."),
        ("urdf/robot.udf:mass", "did you mean `urdf/robot.urdf`?"),
        ("urdf/robot.urdf:mass", "and no `mass`"),
        ("urdf/robot.urdf:99999", "urdf/robot.urdf has the lines 1 to "),
        ("small.yaml:3", "line `3` of small.yaml has no value"),
        ("fl", "single value"),
        ("", "single value"),
        (":", "the robot has no value `:`"),
    ],
)
def test_unknown_values(thorvaldc: Command, path: str, message: str) -> None:
    result = thorvaldc("why", "small.yaml", path)
    assert result.status == 1, result
    assert message in result.err
    assert "Traceback" not in result.err


@pytest.mark.parametrize(
    "path",
    ["ros2/package.xml:1", "wheels.fl.link", "nodes.fl.protocol"],
)
def test_what_no_number_leads_to_is_not_known(thorvaldc: Command, path: str) -> None:
    assert sources(explained(thorvaldc, path)) == []
    assert "not known: no number in a file" in thorvaldc("why", "small.yaml", path).out


def test_wrong_files(thorvaldc: Command) -> None:
    thorvaldc("build", "small.yaml", "-o", "out", "--target", "urdf")
    fleet = "thorvaldc: 1\nname: two\nrobots:\n  a: {robot: small.yaml}\n"
    Path("fleet.yaml").write_text(fleet, encoding="utf-8")
    assert thorvaldc("why", "out/model.json", "mass").status == 2
    assert thorvaldc("why", "out", "mass").status == 2
    assert thorvaldc("why", "fleet.yaml", "mass").status == 2
    assert thorvaldc("why", "bad.yaml", "mass").status == 1
