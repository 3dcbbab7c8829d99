"""On rails a double wheel rolls on its smaller ring, held by its flanges."""

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
# As high as the pipes lift the rings over the floor.
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
    """The result, samples, and what was said."""
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    done = compile_file(path)
    assert done.scenario is not None, [d.message for d in done.report]
    files = emit(done.scenario.fleet, ["mjcf"])
    simulation = ScenarioSimulation(done.scenario, files, parameters)
    seen: list[Any] = []
    report = Report()
    result = simulation.play(report, on_tick=lambda m: seen.append(m.sample()))
    return result, seen, [d.code.name for d in report]


def test_the_small_ring_rolls_on_the_rail(tmp_path: Path) -> None:
    _, seen, _ = played(tmp_path, HEAD + DRIVE)
    first, last = (next(s for s in seen if s.time >= t) for t in (2.5, 6.5))
    way = last.pose_true.x - first.pose_true.x
    turned = last.joints.positions[0] - first.joints.positions[0]
    assert turned > 10.0
    assert way / turned == pytest.approx(RAIL, rel=1e-4)


def test_with_the_set_for_rails_the_distance_is_right(tmp_path: Path) -> None:
    result, _, said = played(tmp_path, HEAD + DRIVE, "rail")
    found = result.metrics["cart"]
    assert said == []  # that the wheels roll on other radii is no fault here
    assert found["path"] > 2.2
    assert found["end_error"] < 0.002
    assert found["slip"] < 0.01
    assert found["collisions"] == 0
    # With the radii of the floor, it is wrong by as much as these are.
    result, _, _ = played(tmp_path, HEAD + DRIVE)
    assert result.metrics["cart"]["length_ratio"] == pytest.approx(RAIL / TYRE, rel=0.002)
    without = HEAD.replace("world: {rails: [{from: [-1 m, 0], to: [6 m, 0], gauge: 720 mm}]}\n", "")
    assert played(tmp_path, without + DRIVE, "rail")[2] == ["parameter-set-scene"]


def test_flanges_hold_it_on_the_rails(tmp_path: Path) -> None:
    text = HEAD.replace("16 mm]", "16 mm], yaw: 1 deg") + DRIVE
    leaning = text.replace(
        "world: {", "world: {ground: {type: slope, angle: 6 deg, direction: 90 deg}, "
    )
    for one in (text, leaning):
        _, seen, _ = played(tmp_path, one, "rail")
        assert seen[-1].pose_true.x > 2.0
        assert abs(seen[-1].pose_true.y) < 0.012
        # Its casters are on the floor: only the front axle is held.
        assert abs(seen[-1].pose_true.yaw) < math.radians(3.0)


def test_sets_change_with_the_script_while_it_drives(tmp_path: Path) -> None:
    script = (
        "script: [{at: 1, vx: 0.3 m/s, parameters: rail}, {at: 4, vx: 0.3 m/s, parameters: floor},"
        " {at: 7, parameters: rail}]\n"
    )
    _, seen, _ = played(tmp_path, HEAD + script)

    def ratio(time: float) -> float:
        sample = next(s for s in seen if s.time >= time)
        return float(sample.true.vx / sample.estimated.vx)

    assert ratio(3.9) == pytest.approx(1.0, abs=0.002)
    assert ratio(6.5) == pytest.approx(RAIL / TYRE, rel=0.002)
    # The pose does not jump.
    steps = [b.pose_estimated.x - a.pose_estimated.x for a, b in itertools.pairwise(seen)]
    assert max(map(abs, steps)) < 0.3 * TYRE / RAIL / 50 * 1.05


def test_from_the_floor_onto_rails_and_back(tmp_path: Path) -> None:
    example = ROOT / "examples/scenarios/greenhouse_rails.yaml"
    done = compile_file(example)
    assert done.scenario is not None
    report = Report()
    result = ScenarioSimulation(done.scenario, emit(done.scenario.fleet, ["mjcf"])).play(report)
    assert result.passed, [d.message for d in report]
    assert result.metrics["cart"]["tilt"] > math.radians(1.0)  # its casters stay on the floor
