"""``thorvaldc why``, as its users call it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.examples import example_robot
from thorvaldc.comparison.robot_difference import field_unit
from thorvaldc.model.facts.robot_facts import facts_document
from thorvaldc.tools.provenance.explanation import FACTS
from thorvaldc.tools.provenance.value_paths import all_paths, value_at

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
"""A search compiles the robot up to 200 times: a robot with few values takes half the time."""
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


def explained(thorvaldc: Command, path: str, file: str = "small.yaml") -> dict[str, object]:
    result = thorvaldc("why", file, path, "--json")
    assert result.status == 0, result.err
    document = json.loads(result.out)
    assert document["complete"]
    return dict(document)


def sources(document: dict[str, object]) -> dict[str, float | None]:
    found_sources = document["sources"]
    assert isinstance(found_sources, list)
    return {source["key"]: source["effect"] for source in found_sources}


def test_the_default_of_a_module_that_another_module_chooses(thorvaldc: Command) -> None:
    result = thorvaldc("why", "small.yaml", "wheels.fl.radius")
    assert result.status == 0
    lines = result.out.splitlines()
    assert lines[0] == "wheels.fl_wheel.radius = 0.2 m"
    assert "small.yaml:5:3" in lines[1]
    assert "    default: 200 mm" in result.out
    assert "published: configuration files of the original, r_wheel" in result.out
    assert "wheel.radius: ${radius}" in result.out
    assert "params.wheel.default: wheel/agri_200" in result.out
    assert "mjcf/robot.xml" in result.out.partition("goes into")[2]
    assert "urdf/robot.urdf" in result.out.partition("its source also changes")[2]
    assert max(map(len, lines)) <= 80


def test_the_lines_of_outputs_that_get_more_lines(thorvaldc: Command) -> None:
    """A changed colour is one more material, and every line after it has another number."""
    value = "0.7059"
    document = explained(thorvaldc, "links.frame_body.visuals.0.color.0")
    outputs = document["outputs"]
    assert isinstance(outputs, list)
    lines_of = {output["file"]: output["lines"] for output in outputs}
    assert thorvaldc("build", "small.yaml", "-o", "out").status == 0
    text = Path("out/mjcf/robot.xml").read_text(encoding="utf-8").splitlines()
    (material,) = [line.split('"')[1] for line in text if f'rgba="{value} ' in line]
    expected = [n for n, line in enumerate(text, 1) if f'"{material}"' in line]
    assert len(lines_of["mjcf/robot.xml"]) >= 3
    assert set(lines_of["mjcf/robot.xml"]) <= set(expected)


def test_effects_of_the_sources_of_a_sum(thorvaldc: Command) -> None:
    effects = sources(explained(thorvaldc, "mass"))
    assert effects["modules.frame.params.width"] == pytest.approx(0.035, abs=0.02)
    # All masses together are the mass.
    masses = [
        effect
        for key, effect in effects.items()
        if key.endswith(("mass", "mass.default")) and effect
    ]
    assert 0.5 < float(sum(masses[1:], masses[0])) < 1.0


def test_a_limit_that_the_robot_file_states(thorvaldc: Command) -> None:
    text = SMALL + "driver: {max_linear_velocity: 1 m/s}\n"
    Path("limited.yaml").write_text(text, encoding="utf-8")
    document = explained(thorvaldc, "limits.linear_velocity", "limited.yaml")
    assert sources(document) == {"driver.max_linear_velocity": pytest.approx(1.0)}


def test_a_fact(thorvaldc: Command) -> None:
    document = explained(thorvaldc, "size.track")
    assert sources(document)["modules.frame.params.width"] == pytest.approx(1.0)
    assert document["unit"] == "m"


@pytest.mark.parametrize("name", ["car", "2wd0ws_greenhouse"])
def test_every_fact_with_a_dimension_has_a_unit(name: str) -> None:
    without = set()
    for part, compute in FACTS.items():
        document = {part: facts_document(compute(example_robot(name)))}
        for path in all_paths(document):
            value = value_at(document, path)
            is_number = isinstance(value, float) or (isinstance(value, list) and bool(value))
            if is_number and not field_unit(path):
                without.add(".".join(path))
            assert not (isinstance(value, str | bool) and field_unit(path)), path
    # The others are lists of names and of objects.
    ratios = {"slopes.friction", "slopes.rolling_resistance"}
    assert without <= {*ratios, "energy.missing", "energy.batteries"}


def test_a_node_id(thorvaldc: Command) -> None:
    document = explained(thorvaldc, "nodes.fl.id")
    assert sources(document) == {"modules.fl.can": None}
    assert {"can/canmap.json", "can/robot.dbc"} <= {use["file"] for use in document["outputs"]}  # type: ignore[attr-defined]


def test_a_calibration_file(thorvaldc: Command) -> None:
    Path("calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    text = SMALL.replace("name: small", "name: small\ncalibration: calibration.yaml")
    Path("measured.yaml").write_text(text, encoding="utf-8")
    assert "wheels.fl_wheel.radius" in sources(
        explained(thorvaldc, "wheels.fl.radius", "measured.yaml")
    )


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
    chain = document["chain"]
    assert isinstance(chain, list)
    assert [step["key"] for step in chain] == [
        "modules.tower.params.height",
        "let.half",
        "modules.pole.params.height",
    ]
    assert chain[0]["place"].startswith("tall.yaml:10:")
    mass = explained(thorvaldc, "links.tower_pole_body.mass", "tall.yaml")
    assert mass["value"] == pytest.approx(2.8)
    assert sources(mass)["modules.tower.params.height"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("path", "value", "key"),
    [
        ("urdf/robot.urdf:frame_body.mass.value", None, "modules.frame.params.width"),
        pytest.param(
            *("can/dcf/fl_controller.dcf:34", 1, "modules.fl.can"), marks=pytest.mark.slow
        ),
    ],
)
def test_a_value_in_an_output(thorvaldc: Command, path: str, value: float | None, key: str) -> None:
    document = explained(thorvaldc, path)
    assert value is None or document["value"] == value
    assert key in sources(document)
    assert document["model_values"]
    listed = document["sources"]
    assert isinstance(listed, list)
    # An expression has no effect of its own: it passes on that of its names.
    assert {s["effect"] for s in listed if s["is_expression"]} <= {None}


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("wheels.fl.radios", "did you mean `radius`?"),
        ("whels.fl.radius", "did you mean `wheels`?"),
        ("modules.frame.params.widht", "did you mean `width`?"),
        ("modules.fram.params.width", "did you mean `frame`?"),
        ("urdf/robot.udf:mass", "did you mean `urdf/robot.urdf`?"),
        ("urdf/robot.urdf:mass.value", "values of urdf/robot.urdf match"),
        ("urdf/robot.urdf:99999", "line 99999 of urdf/robot.urdf has no value"),
        ("urdf/robot.urdf:99999", "the next lines with one: "),
        ("fl", "there are `wheels.fl_wheel`, "),
        ("", "single value"),
        (":", "has no value `:`"),
    ],
)
def test_unknown_values(thorvaldc: Command, path: str, message: str) -> None:
    result = thorvaldc("why", "small.yaml", path)
    assert result.status == 1, result
    assert message in result.err
    assert "Traceback" not in result.err


@pytest.mark.parametrize(
    "path",
    [
        pytest.param("nodes.fl.objects.0x1017:0.value", marks=pytest.mark.exhaustive),
        # No robot has only the changed value: a backend refuses it.
        "frames.fl_controller_tpdo1.signals.steering_position.floating_point",
        "ros2/package.xml:1.format",
    ],
)
def test_values_that_nothing_varies(thorvaldc: Command, path: str) -> None:
    result = thorvaldc("why", "small.yaml", path)
    assert result.status in (0, 1), result
    assert "Traceback" not in result.err


def test_a_constant_of_a_template_has_no_sources(thorvaldc: Command) -> None:
    document = explained(thorvaldc, "mjcf/scene.xml:offheight")
    assert document["sources"] == []
    assert document["model_values"] == []


def test_a_text_is_not_varied(thorvaldc: Command) -> None:
    result = thorvaldc("why", "small.yaml", "wheels.fl.link")
    assert result.status == 0
    assert "not a number" in result.out


def test_wrong_files(thorvaldc: Command) -> None:
    thorvaldc("build", "small.yaml", "-o", "out", "--target", "urdf")
    fleet = "thorvaldc: 1\nname: two\nrobots:\n  a: {robot: small.yaml}\n"
    Path("fleet.yaml").write_text(fleet, encoding="utf-8")
    assert thorvaldc("why", "out/model.json", "mass").status == 2
    assert thorvaldc("why", "out", "mass").status == 2
    assert thorvaldc("why", "fleet.yaml", "mass").status == 2
    assert thorvaldc("why", "bad.yaml", "mass").status == 1
