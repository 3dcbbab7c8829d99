"""Zones of the ground: what they do to wheels agrees with closed-form answers."""

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
    done = compile_file(path)
    assert done.scenario is not None, [d.message for d in done.report]
    simulation = ScenarioSimulation(done.scenario, emit(done.scenario.fleet, ["mjcf"]))
    seen: list[Any] = []
    report = Report()
    result = simulation.play(
        report, on_tick=lambda m: seen.append((m.sample().pose_true, m.base.posture()))
    )
    assert not report.errors, [d.message for d in report.errors]
    return result, simulation, seen


def test_on_ice_a_standing_robot_slides_down_as_friction_lets_it(tmp_path: Path) -> None:
    angle, mu, t = math.radians(8.0), 0.06, 2.0
    slope = "world: {{ground: {{type: slope, angle: 8 deg}}, zones: [{}]}}\n"
    zone = "{xyz: [-5, 0, 0], size: [14, 4], friction: 0.06}"
    text = HEAD + f"duration: {t} s\n"
    held = played(tmp_path, text + slope.format(zone.replace("0.06", "0.6")))[2]
    assert abs(held[-1][0].x) < 0.01
    slid = played(tmp_path, text + slope.format(zone))[2]
    wanted = 0.5 * 9.81 * (math.sin(angle) - mu * math.cos(angle)) * t**2
    assert -slid[-1][0].x == pytest.approx(wanted, rel=0.03)


def test_mud_costs_what_its_resistance_says(tmp_path: Path) -> None:
    path, mass = 0.0, 150.0
    zone = "world: {zones: [{xyz: [0, 0, 0], size: [40, 4], rolling_resistance: 0.15}]}\n"
    firm = played(tmp_path, DRIVE)[0].metrics["cart"]
    mud = played(tmp_path, DRIVE + zone)[0].metrics["cart"]
    path = mud["path"]
    own = compile_file(ROOT / "examples/4wd4ws_slim/robot.yaml").model
    resistance = 0.15 - own.wheels[0].rolling_resistance  # type: ignore[union-attr]
    more = resistance * mass * 9.81 * path
    assert mud["energy"] - firm["energy"] == pytest.approx(more, rel=0.03)


def test_the_last_of_overlapping_zones_is_seen(tmp_path: Path) -> None:
    zones = ", ".join(f"{{xyz: [{x}, 0, 0], size: [3, 3], friction: 0.1}}" for x in (3, 4, 5))
    path = tmp_path / "scenario.yaml"
    path.write_text(HEAD + f"duration: 1 s\nworld: {{zones: [{zones}]}}\n")
    done = compile_file(path)
    assert done.scenario is not None
    scene = ET.fromstring(emit(done.scenario.fleet, ["mjcf"])["mjcf/scene.xml"])
    sizes = [geom.get("size", "") for geom in scene.iter("geom") if "zone/" in geom.get("name", "")]
    tops = [float(size.split()[2]) for size in sizes]
    assert 0 < tops[0] < tops[1] < tops[2] < 0.005


def test_a_wheel_is_in_the_zone_that_it_stands_in(tmp_path: Path) -> None:
    """Ice under the left wheels alone, aslant, and the last of two zones counts."""
    zones = (
        "world: {zones: [{xyz: [3, 0.4, 0], size: [2, 0.4], friction: 0.02},"
        " {xyz: [3.5, -0.4, 0], size: [0.6, 3], yaw: 90 deg, friction: 0.5}]}\n"
    )
    path = tmp_path / "scenario.yaml"
    path.write_text(DRIVE + zones)
    done = compile_file(path)
    assert done.scenario is not None
    simulation = ScenarioSimulation(done.scenario, emit(done.scenario.fleet, ["mjcf"]))
    scene = simulation.scene
    assert scene is not None
    model = scene.model
    treads = {w.name: scene.index("geom", f"cart/{w.link}_tread", r) for _, r in simulation.robots
              for w in r.wheels}  # fmt: skip
    before = model.geom_friction.copy()
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
    own = before[treads["fl_wheel"], 0]
    assert seen["fl_wheel"] == {own, 0.02}
    assert seen["fr_wheel"] == {own, 0.5}
    assert (model.geom_friction == before).all()


def test_a_robot_drives_up_what_is_raised(tmp_path: Path) -> None:
    zone = "world: {zones: [{xyz: [6, 0, 0], size: [8, 8], height: 300 mm, slope: 9 deg}]}\n"
    result, _, seen = played(tmp_path, DRIVE + zone)
    assert seen[-1][0].x > 5.0
    assert seen[-1][1][0] - seen[0][1][0] == pytest.approx(0.3, abs=0.002)
    assert result.metrics["cart"]["tilt"] == pytest.approx(math.radians(9.0), abs=0.02)
    assert result.metrics["cart"]["collisions"] == 0


def test_bumps_shake_where_they_are(tmp_path: Path) -> None:
    zone = (
        "world: {zones: [{xyz: [4, 0, 0], size: [3, 3], amplitude: 15 mm, wavelength: 400 mm,"
        " seed: 2}]}\n"
    )
    _, _, seen = played(tmp_path, DRIVE + zone)
    shaken = [abs(posture[1]) for pose, posture in seen if 3.0 < pose.x < 5.0]
    before = [abs(posture[1]) for pose, posture in seen if pose.x < 1.8]
    assert max(shaken) > math.radians(0.5) > 10 * max(before)
    other = played(tmp_path, DRIVE + zone.replace("seed: 2", "seed: 3"))[2]
    assert other[-1] != seen[-1]
