"""On rails a double wheel rolls on its smaller ring, between its flanges."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.scenario_run import ScenarioResult, ScenarioSimulation

ROOT = Path(__file__).resolve().parents[3]
CART = ROOT / "examples/2wd0ws_greenhouse/robot.yaml"
RAIL, TYRE = 0.09, 0.125
# The robot starts 16 mm above the floor: on the pipes.
HEAD = f"""thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: {CART}, xyz: [0, 0, 16 mm]}}}}
duration: 8 s
world: {{rails: [{{from: [-1 m, 0], to: [6 m, 0], gauge: 720 mm}}]}}
"""
DRIVE = "script: [{at: 1, vx: 0.5 m/s}, {at: 7}]\n"


def played(
    folder: Path, text: str, parameters: str | None = None
) -> tuple[ScenarioResult, list[Any], list[str]]:
    """Returns the result, the samples, and the names of the diagnostics."""
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    compilation = compile_file(path)
    assert compilation.scenario is not None, [d.message for d in compilation.report]
    files = emit(compilation.scenario.fleet, ["mjcf"])
    simulation = ScenarioSimulation(compilation.scenario, files, parameters)
    samples: list[Any] = []
    report = Report()
    result = simulation.play(report, on_tick=lambda m: samples.append(m.sample()))
    return result, samples, [d.code.name for d in report]


def test_the_small_ring_rolls_on_the_rail(tmp_path: Path) -> None:
    _, samples, _ = played(tmp_path, HEAD + DRIVE)
    first, last = (next(s for s in samples if s.time >= t) for t in (2.5, 6.5))
    distance = last.pose_true.x - first.pose_true.x
    angle = last.joints.positions[0] - first.joints.positions[0]
    assert angle > 10.0
    assert distance / angle == pytest.approx(RAIL, rel=1e-4)


def test_with_the_parameter_set_for_rails_the_distance_is_correct(tmp_path: Path) -> None:
    result, _, diagnostics = played(tmp_path, HEAD + DRIVE, "rail")
    metrics = result.metrics["cart"]
    # The set limits the speed to 0.4 m/s.
    assert diagnostics == [
        "twist-limited"
    ]  # with rails, other radii than those of the scene are correct
    assert metrics["path"] > 2.2
    assert metrics["end_error"] < 0.002
    assert metrics["slip"] < 0.01
    assert metrics["collisions"] == 0
    # With the radii for the floor, the error is the ratio of the radii.
    result, _, _ = played(tmp_path, HEAD + DRIVE)
    assert result.metrics["cart"]["length_ratio"] == pytest.approx(RAIL / TYRE, rel=0.002)
    without = HEAD.replace("world: {rails: [{from: [-1 m, 0], to: [6 m, 0], gauge: 720 mm}]}\n", "")
    assert played(tmp_path, without + DRIVE, "rail")[2] == ["parameter-set-scene", "twist-limited"]


def test_flanges_keep_the_robot_on_the_rails(tmp_path: Path) -> None:
    text = HEAD.replace("16 mm]", "16 mm], yaw: 1 deg") + DRIVE
    leaning = text.replace(
        "world: {", "world: {ground: {type: slope, angle: 6 deg, direction: 90 deg}, "
    )
    for scenario in (text, leaning):
        _, samples, _ = played(tmp_path, scenario, "rail")
        assert samples[-1].pose_true.x > 2.0
        assert abs(samples[-1].pose_true.y) < 0.012
        # The casters are on the floor: the rails guide only the front axle.
        assert abs(samples[-1].pose_true.yaw) < math.radians(3.0)


def test_the_script_changes_parameter_sets_while_the_robot_drives(tmp_path: Path) -> None:
    script = (
        "script: [{at: 1, vx: 0.3 m/s, parameters: rail}, {at: 4, vx: 0.3 m/s, parameters: floor},"
        " {at: 7, parameters: rail}]\n"
    )
    _, samples, _ = played(tmp_path, HEAD + script)

    def ratio(time: float) -> float:
        sample = next(s for s in samples if s.time >= time)
        return float(sample.true.vx / sample.estimated.vx)

    assert ratio(3.9) == pytest.approx(1.0, abs=0.002)
    assert ratio(6.5) == pytest.approx(RAIL / TYRE, rel=0.002)
    # The pose does not jump.
    steps = [b.pose_estimated.x - a.pose_estimated.x for a, b in itertools.pairwise(samples)]
    assert max(map(abs, steps)) < 0.3 * TYRE / RAIL / 50 * 1.05


def test_from_the_floor_onto_rails_and_back(tmp_path: Path) -> None:
    example = ROOT / "examples/scenarios/greenhouse_rails.yaml"
    compilation = compile_file(example)
    assert compilation.scenario is not None
    report = Report()
    result = ScenarioSimulation(
        compilation.scenario, emit(compilation.scenario.fleet, ["mjcf"])
    ).play(report)
    assert result.passed, [d.message for d in report]
    assert result.metrics["cart"]["tilt"] > math.radians(1.0)  # the casters stay on the floor
