"""Scenarios run: what is broken shows, what is expected decides, what is recorded is there."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.backends.mjcf_terrain import heights
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Ground, Pose
from thorvaldc.simulation.records.csv_record import CsvRecorder
from thorvaldc.simulation.scenario_run import ScenarioResult, ScenarioSimulation

ROOT = Path(__file__).resolve().parents[2]
HEAD = f"""thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: {ROOT}/examples/4wd4ws_slim/robot.yaml}}}}
duration: 4 s
script: [{{at: 0, vx: 0.8 m/s}}]
"""


def simulation(folder: Path, text: str) -> ScenarioSimulation:
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    done = compile_file(path)
    assert done.scenario is not None, [d.message for d in done.report]
    return ScenarioSimulation(done.scenario, emit(done.scenario.fleet, ["mjcf"], Report()))


def play(folder: Path, text: str) -> tuple[ScenarioResult, list[str]]:
    report = Report()
    result = simulation(folder, text).play(report)
    return result, [d.code.name for d in report.errors]


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def measured(folder: Path, text: str) -> Any:
    result, errors = play(folder, text)
    assert errors == []
    return result.metrics["cart"]


def test_without_faults_it_drives_as_asked(tmp_path: Path) -> None:
    found = measured(tmp_path, HEAD)
    assert found["path"] == pytest.approx(0.8 * 4, abs=0.4)
    assert found["end_error"] < 0.01  # the tyres give way while it speeds up
    assert found["length_ratio"] == pytest.approx(1.0, abs=3e-3)
    assert found["slip"] < 0.01
    assert found["collisions"] == found["steering_limit_hits"] == 0


def test_runs_are_equal_to_the_last_bit(tmp_path: Path) -> None:
    text = HEAD + (
        "world: {ground: {type: rough, seed: 3, size: [10, 6]}}\n"
        "noise: {seed: 2, steering_angle: 0.1 deg}\n"
        "faults: [{type: motor_lost, wheel: fl_wheel, at: 1, until: 2},"
        " {type: ice, wheel: fr_wheel, friction: 0.02, at: 2}]\n"
    )
    drive = simulation(tmp_path, text)
    first, second = drive.play(Report()).hash, drive.play(Report()).hash
    assert first == second
    command = [sys.executable, "-m", "thorvaldc", "sim", str(tmp_path / "scenario.yaml")]
    for seed in ("1", "77"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        )
        assert f"result {first[:16]}" in done.stdout
    assert play(tmp_path, text.replace("seed: 2", "seed: 5"))[0].hash != first


def test_the_ways_uphill_take_energy(tmp_path: Path) -> None:
    slope = "world: {{ground: {{type: slope, angle: 5 deg, direction: {} deg}}}}\n"
    level = measured(tmp_path, HEAD)
    up = measured(tmp_path, HEAD + slope.format(0))
    down = measured(tmp_path, HEAD + slope.format(180))
    mass = 150.0
    lifted = mass * 9.81 * math.sin(math.radians(5.0)) * up["path"]
    assert up["energy"] - level["energy"] == pytest.approx(lifted, rel=0.05)
    assert down["energy"] < level["energy"]


@pytest.mark.parametrize(
    ("fault", "metric", "low", "high"),
    [
        ("{type: radius_error, wheel: fl_wheel, error: 3 %}", "yaw_error", 1e-4, 0.2),
        ("{type: steering_offset, wheel: fl_wheel, angle: 3 deg}", "slip", 0.005, 0.2),
        ("{type: encoder_frozen, wheel: fl_wheel, motor: steering}", "end_error", 0.0, 0.1),
        ("{type: ice, wheel: fl_wheel, friction: 0.01}", "end_error", 0.0, 0.1),
    ],
)
def test_faults_show(tmp_path: Path, fault: str, metric: str, low: float, high: float) -> None:
    found = measured(tmp_path, HEAD + f"faults: [{fault}]\n")
    assert low <= found[metric] <= high


def test_a_lost_motor_comes_back_and_leaves_the_scene_as_it_was(tmp_path: Path) -> None:
    text = HEAD + "faults: [{type: motor_lost, wheel: fl_wheel, at: 0.5, until: 3}]\n"
    drive = simulation(tmp_path, text)
    assert drive.scene is not None
    before = drive.scene.model.actuator_gainprm.copy()
    energy = []
    report = Report()
    result = drive.play(report, on_tick=lambda m: energy.append(m.sample().joints))
    assert list(report.errors) == []
    assert (drive.scene.model.actuator_gainprm == before).all()
    assert result.metrics["cart"]["end_error"] < 0.05
    speeds = [joints.speeds[0] for joints in energy if joints is not None]
    assert speeds[-1] == pytest.approx(0.8 / 0.2, rel=0.05)


def test_frozen_encoders_stand_for_as_long(tmp_path: Path) -> None:
    text = HEAD + "faults: [{type: encoder_frozen, wheel: fl_wheel, at: 1, until: 2}]\n"
    seen: list[tuple[float, float]] = []

    def on_tick(loop: Any) -> None:
        joints = loop.sample().joints
        seen.append((joints.time, joints.positions[0]))

    simulation(tmp_path, text).play(Report(), on_tick=on_tick)
    held = {position for time, position in seen if 1.0 <= time < 2.0}
    assert len(held) == 1
    assert len({position for time, position in seen if time >= 2.0}) > 50


def test_what_is_touched_counts(tmp_path: Path) -> None:
    box = "world: {obstacles: {box: {shape: box, xyz: [2, 0, 0], size: [0.2, 2, 1]}}}\n"
    result, errors = play(tmp_path, HEAD + box + "expect: {collisions: {max: 0}}\n")
    assert result.metrics["cart"]["collisions"] >= 1
    assert "expectation-failed" in errors
    assert not result.passed
    kerb = "world: {kerbs: [{from: [1.5, -2], to: [1.5, 2], height: 0.03}]}\n"
    result, errors = play(tmp_path, HEAD + kerb + "expect: {collisions: {max: 0}}\n")
    assert errors == []
    assert result.metrics["cart"]["tilt"] > math.radians(0.5)


def test_who_falls_over_is_told_with_time_and_way_and_the_record_is_kept(tmp_path: Path) -> None:
    text = HEAD.replace("4wd4ws_slim", "4wd2ws_tall").replace("4 s", "40 s")
    text += "world: {ground: {type: slope, angle: 58 deg, direction: 90 deg}, friction: 4.5}\n"
    drive = simulation(tmp_path, text)
    recorder = CsvRecorder(tmp_path / "records", drive.robots, ("truth",))
    report = Report()
    result = drive.play(report, [recorder])
    recorder.close()
    (fault,) = report.errors
    assert fault.code.name == "simulation-tipped"
    assert "fell over to its right after 1." in fault.message
    assert "lower its speed" in (fault.hint or "")
    assert not result.completed
    rows = read(tmp_path / "records/cart.csv")
    assert float(rows[-1]["time"]) == pytest.approx(result.run.simulated)


def test_who_starts_within_an_obstacle_is_not_told_to_drive_slower(tmp_path: Path) -> None:
    crate = "{shape: box, xyz: [0.55, 0, 0.1], size: [1.2, 1.2, 0.1]}"
    drive = simulation(tmp_path, HEAD + f"world: {{obstacles: {{crate: {crate}}}}}\n")
    report = Report()
    drive.play(report, [])
    assert "start inside an obstacle" in (report.errors[0].hint or "")


def test_records_have_the_groups_and_times_that_are_wanted(tmp_path: Path) -> None:
    text = HEAD + "record: {what: [truth, joints], every: 0.1 s}\n"
    drive = simulation(tmp_path, text)
    scenario = drive.scenario
    recorder = CsvRecorder(tmp_path / "r", drive.robots, scenario.record, scenario.every)
    drive.play(Report(), [recorder])
    recorder.close()
    rows = read(tmp_path / "r/cart.csv")
    assert len(rows) == 41
    assert {"true_x", "fl_drive_axle_position"} <= rows[0].keys()
    assert not any(name.startswith(("odometry", "asked")) for name in rows[0])
    # A driven wheel's turn is the way over its radius.
    way = float(rows[-1]["true_x"])
    turned = float(rows[-1]["fl_drive_axle_position"]) - float(rows[0]["fl_drive_axle_position"])
    assert turned * 0.2 == pytest.approx(way, rel=0.01)


def test_rough_ground_is_as_high_as_it_says_and_level_where_robots_start() -> None:
    ground = Ground(amplitude=0.02, wavelength=1.0, seed=5, size=(20.0, 10.0))
    rows = heights(ground, [Pose((2.0, 1.0, 0.0))])
    inner = [h for row in rows[20:-20] for h in row[20:-20]]
    assert 0.0 <= min(inner) < 0.3
    assert 0.7 < max(inner) <= 1.0
    x, y = round((2.0 + 10.0) * 10), round((1.0 + 5.0) * 10)
    assert {rows[y + dy][x + dx] for dx in range(-9, 10) for dy in range(-9, 10)} == {0.5}
    assert rows[0][5] == rows[5][0] == 0.0
    assert heights(ground, []) == heights(ground, [])
    assert heights(Ground(0, 0, 0.02, 1.0, 6, (20.0, 10.0)), []) != heights(ground, [])


def test_who_diverges_is_told_with_time_and_cause(tmp_path: Path) -> None:
    drive = simulation(tmp_path, HEAD)

    def on_tick(loop: Any) -> None:
        if loop.driver.state.time >= 1.0:
            loop.scene.data.qvel[7] = 1e7

    report = Report()
    result = drive.play(report, on_tick=on_tick)
    (fault,) = report.errors
    assert fault.code.name == "simulation-diverged"
    assert "after 1.0" in fault.message
    assert "the joint `cart/" in fault.message
    assert not result.passed


def test_an_interrupted_run_leaves_whole_records(tmp_path: Path) -> None:
    drive = simulation(tmp_path, HEAD)
    recorder = CsvRecorder(tmp_path / "r", drive.robots, drive.scenario.record)

    def on_tick(loop: Any) -> None:
        if loop.driver.state.time >= 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive.play(Report(), [recorder], on_tick)
    recorder.close()
    rows = read(tmp_path / "r/cart.csv")
    assert float(rows[-1]["time"]) == 1.0
    assert all(None not in row.values() for row in rows)
