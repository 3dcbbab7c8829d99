"""Ground zones: friction, rolling resistance and height agree with closed-form results."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.scenario_run import ScenarioResult, ScenarioSimulation

ROOT = Path(__file__).resolve().parents[3]
HEAD = f"""thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: {ROOT}/examples/4wd4ws_slim/robot.yaml}}}}
"""
DRIVE = HEAD + "duration: 8 s\nscript: [{at: 0, vx: 0.8 m/s}]\n"


def played(folder: Path, text: str) -> tuple[ScenarioResult, ScenarioSimulation, list[Any]]:
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    compilation = compile_file(path)
    assert compilation.scenario is not None, [d.message for d in compilation.report]
    simulation = ScenarioSimulation(
        compilation.scenario, emit(compilation.scenario.fleet, ["mjcf"])
    )
    seen: list[Any] = []
    report = Report()
    result = simulation.play(
        report, on_tick=lambda m: seen.append((m.sample().pose_true, m.base.posture()))
    )
    assert not report.errors, [d.message for d in report.errors]
    return result, simulation, seen


def test_a_braking_robot_slides_down_an_icy_slope_with_the_closed_form(tmp_path: Path) -> None:
    angle, mu, t = math.radians(8.0), 0.06, 2.0
    slope = "world: {{ground: {{type: slope, angle: 8 deg}}, zones: [{}]}}\n"
    zone = "{xyz: [-5, 0, 0], size: [14, 4], friction: 0.06}"
    text = HEAD + f"duration: {t} s\n"
    still = played(tmp_path, text + slope.format(zone.replace("0.06", "0.6")))[2]
    assert abs(still[-1][0].x) < 0.01
    sliding = played(tmp_path, text + slope.format(zone))[2]
    expected = 0.5 * 9.81 * (math.sin(angle) - mu * math.cos(angle)) * t**2
    assert -sliding[-1][0].x == pytest.approx(expected, rel=0.03)


def test_work_in_mud_agrees_with_its_rolling_resistance(tmp_path: Path) -> None:
    mass = 150.0
    zone = "world: {zones: [{xyz: [0, 0, 0], size: [40, 4], rolling_resistance: 0.15}]}\n"
    firm = played(tmp_path, DRIVE)[0].metrics["cart"]
    mud = played(tmp_path, DRIVE + zone)[0].metrics["cart"]
    path = mud["path"]
    robot = compile_file(ROOT / "examples/4wd4ws_slim/robot.yaml").model
    resistance = 0.15 - robot.wheels[0].rolling_resistance  # type: ignore[union-attr]
    extra_work = resistance * mass * 9.81 * path
    assert mud["energy"] - firm["energy"] == pytest.approx(extra_work, rel=0.03)


def test_the_last_of_overlapping_zones_is_drawn_on_top(tmp_path: Path) -> None:
    zones = ", ".join(f"{{xyz: [{x}, 0, 0], size: [3, 3], friction: 0.1}}" for x in (3, 4, 5))
    path = tmp_path / "scenario.yaml"
    path.write_text(HEAD + f"duration: 1 s\nworld: {{zones: [{zones}]}}\n")
    compilation = compile_file(path)
    assert compilation.scenario is not None
    scene = ET.fromstring(emit(compilation.scenario.fleet, ["mjcf"])["mjcf/scene.xml"])
    sizes = [geom.get("size", "") for geom in scene.iter("geom") if "zone/" in geom.get("name", "")]
    tops = [float(size.split()[2]) for size in sizes]
    assert 0 < tops[0] < tops[1] < tops[2] < 0.005


def test_each_wheel_has_the_friction_of_its_zone(tmp_path: Path) -> None:
    """Ice under the left wheels only, and a second zone that is turned by 90 deg."""
    zones = (
        "world: {zones: [{xyz: [3, 0.4, 0], size: [2, 0.4], friction: 0.02},"
        " {xyz: [3.5, -0.4, 0], size: [0.6, 3], yaw: 90 deg, friction: 0.5}]}\n"
    )
    path = tmp_path / "scenario.yaml"
    path.write_text(DRIVE + zones)
    compilation = compile_file(path)
    assert compilation.scenario is not None
    simulation = ScenarioSimulation(
        compilation.scenario, emit(compilation.scenario.fleet, ["mjcf"])
    )
    scene = simulation.scene
    assert scene is not None
    model = scene.model
    treads = {
        w.name: scene.index("geom", f"cart/{w.link}_tread", r)
        for r in simulation.robots.values()
        for w in r.wheels
    }
    frictions = model.geom_friction.copy()
    seen: dict[str, set[float]] = {name: set() for name in treads}

    def on_tick(_: Any) -> None:
        for name, geom in treads.items():
            mu = float(model.geom_friction[geom, 0])
            seen[name].add(mu)
            x, y, _ = scene.data.geom_xpos[geom].tolist()
            if mu == 0.02:
                assert 1.97 < x < 4.03
                assert 0.2 < y < 0.6

    simulation.play(Report(), on_tick=on_tick)
    own = frictions[treads["fl_wheel"], 0]
    assert seen["fl_wheel"] == {own, 0.02}
    assert seen["fr_wheel"] == {own, 0.5}
    assert (model.geom_friction == frictions).all()


def test_a_robot_drives_up_a_raised_zone(tmp_path: Path) -> None:
    zone = "world: {zones: [{xyz: [6, 0, 0], size: [8, 8], height: 300 mm, slope: 9 deg}]}\n"
    result, _, seen = played(tmp_path, DRIVE + zone)
    assert seen[-1][0].x > 5.0
    assert seen[-1][1][0] - seen[0][1][0] == pytest.approx(0.3, abs=0.002)
    assert result.metrics["cart"]["tilt"] == pytest.approx(math.radians(9.0), abs=0.02)
    assert result.metrics["cart"]["collisions"] == 0


def test_bumps_tilt_the_robot_only_in_their_zone(tmp_path: Path) -> None:
    zone = (
        "world: {zones: [{xyz: [4, 0, 0], size: [3, 3], amplitude: 15 mm, wavelength: 400 mm,"
        " seed: 2}]}\n"
    )
    _, _, seen = played(tmp_path, DRIVE + zone)
    on_bumps = [abs(posture[1]) for pose, posture in seen if 3.0 < pose.x < 5.0]
    on_plane = [abs(posture[1]) for pose, posture in seen if pose.x < 1.8]
    assert max(on_bumps) > math.radians(0.5) > 10 * max(on_plane)
    other_seed = played(tmp_path, DRIVE + zone.replace("seed: 2", "seed: 3"))[2]
    assert other_seed[-1] != seen[-1]
