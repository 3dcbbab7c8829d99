"""Scenario documents: the resulting model, and diagnostics of invalid ones."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import Report
from thorvaldc.model import Box, Cylinder, Ground, Sphere
from thorvaldc.model.scenario import Command, Noise, Scenario

ROOT = Path(__file__).resolve().parents[3]
SLIM = ROOT / "examples/4wd4ws_slim/robot.yaml"
HEAD = f"""thorvaldc: 1
scenario: trial
robots:
  cart: {{robot: {SLIM}, xyz: [1, 2, 0], yaw: 90 deg}}
duration: 2 s
"""


def compiled(folder: Path, text: str, robot: Path | None = None) -> Compilation:
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    return compile_file(path, robot=robot)


def scenario_of(folder: Path, text: str, robot: Path | None = None) -> Scenario:
    compilation = compiled(folder, text, robot)
    assert [(d.code.name, d.message) for d in compilation.report.errors] == []
    assert compilation.scenario is not None
    assert compilation.model is compilation.scenario.fleet
    return compilation.scenario


def errors_of(folder: Path, text: str) -> list[tuple[str, int]]:
    compilation = compiled(folder, text)
    assert compilation.scenario is None
    assert compilation.model is None
    return [(d.code.name, d.span.line if d.span else 0) for d in compilation.report.errors]


def test_defaults_of_an_empty_scenario(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, HEAD)
    assert scenario.duration == 2.0
    assert scenario.commands == (("cart", ()),)
    assert scenario.noise == Noise()
    assert scenario.fleet.world is not None
    assert scenario.fleet.world.ground == Ground()
    assert scenario.fleet.world.blocks == ()


def test_replacing_robot_gets_name_and_pose_of_the_entry(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path, HEAD, ROOT / "examples/6wd6ws/robot.yaml")
    (placed,) = scenario.fleet.placements
    assert (placed.name, placed.robot.namespace, len(placed.robot.wheels)) == ("cart", "cart", 6)
    assert placed.pose.xyz == (1.0, 2.0, 0.0)
    fleet = scenario_of(tmp_path, HEAD, ROOT / "examples/fleet_of_four/fleet.yaml").fleet
    assert [p.name for p in fleet.placements] == ["tall", "slim", "wide", "six"]


def test_fleet_file_in_a_scenario(tmp_path: Path) -> None:
    text = "thorvaldc: 1\nscenario: x\nfleet: {}\nduration: 1 s\n"
    scenario = scenario_of(tmp_path, text.format(ROOT / "examples/fleet_of_four/fleet.yaml"))
    assert len(scenario.fleet.placements) == 4
    assert errors_of(tmp_path, text.format("none.yaml")) == [("fleet-robot-missing", 3)]
    assert errors_of(tmp_path, text.format("scenario.yaml")) == [("fleet-in-fleet", 3)]


def test_a_scenario_without_its_name_is_no_robot(tmp_path: Path) -> None:
    text = "thorvaldc: 1\nrobot: robot.yaml\nduration: 1 s\nworld: {}\n"
    assert errors_of(tmp_path, text) == [("missing-key", 1), ("unknown-key", 2)]
    (missing, _) = compiled(tmp_path, text).report.errors
    assert missing.message == "the scenario document has no `scenario`"


def test_script_commands_all_robots_or_one(tmp_path: Path) -> None:
    robots = f"robots: {{a: {{robot: {SLIM}}}, b: {{robot: {SLIM}, xyz: [0, 5, 0]}}}}\n"
    text = "thorvaldc: 1\nscenario: x\n" + robots + "duration: 1 s\nscript:\n"
    text += "  - {at: 0, vx: 36 kph}\n  - {at: 0.5, robot: b, wz: 1, vy: 2}\n"
    commands = dict(scenario_of(tmp_path, text).commands)
    assert commands["a"] == (Command(0.0, 10.0, 0.0, 0.0),)
    assert commands["b"] == (Command(0.0, 10.0, 0.0, 0.0), Command(0.5, 0.0, 2.0, 1.0))
    assert errors_of(tmp_path, text + "faults: [{type: motor_lost, wheel: fl_wheel}]\n") == [
        ("missing-key", 8)
    ]


def test_world_is_expanded_to_blocks(tmp_path: Path) -> None:
    world = """world:
  friction: 0.4
  kerbs: [{from: [0, 0], to: [0, 2], height: 0.1, width: 0.2}]
  rails: [{from: [0, 0], to: [4, 0], gauge: 0.6, diameter: 0.05}]
  crop_rows: [{xyz: [4, 1, 0], yaw: 90 deg, rows: 2, row_spacing: 1, plants: 3, plant_spacing: 0.5}]
  polytunnels: [{xyz: [0, 0, 0], length: 4, width: 6, post_spacing: 2}]
  obstacles: {box: {shape: box, xyz: [5, 0, 0], size: [1, 1, 2]}}
"""
    scenario = scenario_of(tmp_path, HEAD + world)
    assert {w.friction for w in scenario.fleet.placements[0].robot.wheels} == {0.4}
    assert scenario.fleet.world is not None
    blocks = {f"{b.kind}/{b.name}": b for b in scenario.fleet.world.blocks}
    assert len(blocks) == 1 + 2 + 6 + 6 + 1
    kerb = blocks["kerb/1"]
    assert kerb.shape == Box((2.0, 0.2, 0.1))
    assert kerb.pose.apply((1.0, 0.0, 0.05)) == pytest.approx((0.0, 2.0, 0.1), abs=1e-9)
    rail = blocks["rail/1_left"]
    assert rail.shape == Cylinder(0.025, 4.0)
    assert rail.pose.apply((0.0, 0.0, 2.0)) == pytest.approx((4.0, 0.3, 0.025), abs=1e-9)
    assert blocks["crop/1_2_3"].pose.xyz == pytest.approx((3.0, 2.0, 0.2), abs=1e-9)
    assert blocks["post/1_right_3"].pose.xyz == pytest.approx((4.0, -3.0, 1.0), abs=1e-9)
    assert blocks["obstacle/box"].pose.xyz == (5.0, 0.0, 1.0)


def test_obstacles_stand_on_their_height(tmp_path: Path) -> None:
    world = """world:
  obstacles:
    ball: {shape: sphere, xyz: [1, 5, 0.5], diameter: 0.6}
    post: {shape: cylinder, xyz: [3, 0, 0], yaw: 90 deg, diameter: 0.2, height: 1.4}
    crate: {shape: box, xyz: [0, 4, 1], yaw: 90 deg, size: [1, 2, 3]}
"""
    scenario = scenario_of(tmp_path, HEAD + world)
    assert scenario.fleet.world is not None
    shapes = {b.name: (b.shape, b.pose.xyz) for b in scenario.fleet.world.blocks}
    assert shapes == {
        "ball": (Sphere(0.3), (1.0, 5.0, 0.8)),
        "post": (Cylinder(0.1, 1.4), (3.0, 0.0, 0.7)),
        "crate": (Box((1.0, 2.0, 3.0)), (0.0, 4.0, 2.5)),
    }
    scene = emit(scenario.fleet, ["mjcf"], Report())["mjcf/scene.xml"].decode()
    geoms = {g.get("name"): g for g in ET.fromstring(scene).iter("geom")}
    sizes = {"ball": "0.3", "post": "0.1 0.7", "crate": "0.5 1 1.5"}
    for name, size in sizes.items():
        (geom,) = [g for n, g in geoms.items() if n and n.endswith(name)]
        assert geom.get("size") == size


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("world: {ground: {type: swamp}}", "unknown-value", 6),
        ("world: {ground: {type: slope}}", "missing-key", 6),
        ("world: {ground: {type: plane, seed: 1}}", "conflicting-keys", 6),
        ("world: {ground: {type: rough, wavelength: 0.05, size: [900, 900]}}", "out-of-range", 6),
        ("world: {kerbs: [{from: [1, 1], to: [1, 1], height: 0.1}]}", "out-of-range", 6),
        ("world: {obstacles: {a: {shape: sphere, xyz: [1, 0, 0]}}}", "missing-key", 6),
        ("script:\n  - {at: 1}\n  - {at: 0.5}", "out-of-range", 8),
        ("faults: [{type: ice, wheel: fl_wheel}]", "missing-key", 6),
        ("faults: [{type: ice, wheel: fl_wheel, friction: 1, at: 2, until: 1}]", "out-of-range", 6),
        ("expect: {tilt: {min: 2, max: 1}}", "out-of-range", 6),
        ("expect: {tilt: {max: 1 m}}", "wrong-dimension", 6),
        ("fleet: x.yaml", "conflicting-keys", 6),
        ("variations: {vary: {world.friction: [0.3]}}", "unknown-key", 6),
    ],
)
def test_diagnostics_of_invalid_scenarios(tmp_path: Path, text: str, code: str, line: int) -> None:
    assert (code, line) in errors_of(tmp_path, HEAD + text + "\n")


def test_only_the_robot_is_reported_if_it_does_not_compile(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("thorvaldc: 1\nname: x\nmodules: {a: {type: no/ne}}\n")
    text = "thorvaldc: 1\nscenario: x\nrobots: {cart: {robot: robot.yaml}}\nduration: 1 s\n"
    text += "script: [{at: 0, robot: cart, vx: 1}]\n"
    assert errors_of(tmp_path, text) == [("module-type-unknown", 3)]
