"""Scenario runs: injected faults, metrics, expectations and records."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.backends.mjcf_terrain import relief_of
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
    compilation = compile_file(path)
    assert compilation.scenario is not None, [d.message for d in compilation.report]
    return ScenarioSimulation(
        compilation.scenario, emit(compilation.scenario.fleet, ["mjcf"], Report())
    )


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


def test_without_faults_the_robot_follows_the_script(tmp_path: Path) -> None:
    metrics = measured(tmp_path, HEAD)
    assert metrics["path"] == pytest.approx(0.8 * 4, abs=0.4)
    assert metrics["end_error"] < 0.01  # the tyres slip a little while it accelerates
    assert metrics["length_ratio"] == pytest.approx(1.0, abs=3e-3)
    assert metrics["slip"] < 0.01
    assert metrics["energy_per_metre"] == metrics["energy"] / metrics["path"] > 0.0
    assert metrics["collisions"] == metrics["steering_limit_hits"] == 0


def test_a_robot_that_stands_has_no_energy_per_metre(tmp_path: Path) -> None:
    text = HEAD.replace("vx: 0.8 m/s", "vx: 0")
    result, errors = play(tmp_path, text + "expect: {energy_per_metre: {max: 900 J/m}}\n")
    assert result.metrics["cart"]["energy_per_metre"] == math.inf
    assert errors == ["expectation-failed"]


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
        process = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        )
        assert f"result {first[:16]}" in process.stdout
    assert play(tmp_path, text.replace("seed: 2", "seed: 5"))[0].hash != first


def test_driving_uphill_takes_energy(tmp_path: Path) -> None:
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
def test_injected_faults_change_the_metrics(
    tmp_path: Path, fault: str, metric: str, low: float, high: float
) -> None:
    metrics = measured(tmp_path, HEAD + f"faults: [{fault}]\n")
    assert low <= metrics[metric] <= high


def test_a_lost_motor_recovers_and_the_scene_is_restored(tmp_path: Path) -> None:
    text = HEAD + "faults: [{type: motor_lost, wheel: fl_wheel, at: 0.5, until: 3}]\n"
    drive = simulation(tmp_path, text)
    assert drive.scene is not None
    gains = drive.scene.model.actuator_gainprm.copy()
    joints_of_ticks = []
    report = Report()
    result = drive.play(report, on_tick=lambda m: joints_of_ticks.append(m.sample().joints))
    assert list(report.errors) == []
    assert (drive.scene.model.actuator_gainprm == gains).all()
    assert result.metrics["cart"]["end_error"] < 0.05
    speeds = [joints.speeds[0] for joints in joints_of_ticks if joints is not None]
    assert speeds[-1] == pytest.approx(0.8 / 0.2, rel=0.05)


def test_a_fault_that_lasts_ends_with_the_run(tmp_path: Path) -> None:
    """The scene of a simulation serves the next run."""
    drive = simulation(tmp_path, HEAD + "faults: [{type: motor_lost, wheel: fl_wheel, at: 0.5}]\n")
    assert drive.scene is not None
    gains = drive.scene.model.actuator_gainprm.copy()
    drive.play(Report())
    assert (drive.scene.model.actuator_gainprm == gains).all()


def test_a_frozen_encoder_does_not_change(tmp_path: Path) -> None:
    text = HEAD + "faults: [{type: encoder_frozen, wheel: fl_wheel, at: 1, until: 2}]\n"
    positions: list[tuple[float, float]] = []

    def on_tick(loop: Any) -> None:
        joints = loop.sample().joints
        positions.append((joints.time, joints.positions[0]))

    simulation(tmp_path, text).play(Report(), on_tick=on_tick)
    frozen = {position for time, position in positions if 1.0 <= time < 2.0}
    assert len(frozen) == 1
    assert len({position for time, position in positions if time >= 2.0}) > 50


def test_collisions_count_obstacles_but_not_kerbs(tmp_path: Path) -> None:
    box = "world: {obstacles: {box: {shape: box, xyz: [2, 0, 0], size: [0.2, 2, 1]}}}\n"
    result, errors = play(tmp_path, HEAD + box + "expect: {collisions: {max: 0}}\n")
    assert result.metrics["cart"]["collisions"] >= 1
    assert "expectation-failed" in errors
    assert not result.passed
    kerb = "world: {kerbs: [{from: [1.5, -2], to: [1.5, 2], height: 0.03}]}\n"
    result, errors = play(tmp_path, HEAD + kerb + "expect: {collisions: {max: 0}}\n")
    assert errors == []
    assert result.metrics["cart"]["tilt"] > math.radians(0.5)


@pytest.mark.parametrize(
    ("shape", "hits"),
    [
        ("{shape: sphere, xyz: [1.6, 0, 0], diameter: 1}", True),
        ("{shape: cylinder, xyz: [1.6, 0, 0], diameter: 1, height: 1.5}", True),
        # Beside the robot's path.
        ("{shape: cylinder, xyz: [1.6, 1.4, 0], diameter: 1, height: 1.5}", False),
        ("{shape: sphere, xyz: [1.6, 1.4, 0], diameter: 1}", False),
        ("{shape: box, xyz: [1.6, 1.4, 0], size: [1, 1, 1]}", False),
        # Above the robot.
        ("{shape: sphere, xyz: [1.6, 0, 2], diameter: 1}", False),
        ("{shape: cylinder, xyz: [1.6, 0, 2], diameter: 1, height: 0.4}", False),
    ],
)
def test_obstacles_of_each_shape_are_where_they_are_described(
    shape: str, hits: bool, tmp_path: Path
) -> None:
    world = f"world: {{obstacles: {{thing: {shape}}}}}\n"
    result, _ = play(tmp_path, HEAD + world)
    assert (result.metrics["cart"]["collisions"] >= 1) is hits


def test_tip_over_is_reported_with_time_and_direction_and_the_record_is_kept(
    tmp_path: Path,
) -> None:
    text = HEAD.replace("4wd4ws_slim", "4wd2ws_tall").replace("4 s", "40 s")
    text += "world: {ground: {type: slope, angle: 58 deg, direction: 90 deg}, friction: 4.5}\n"
    drive = simulation(tmp_path, text)
    recorder = CsvRecorder(tmp_path / "records", [*drive.robots.items()], ("truth",))
    report = Report()
    result = drive.play(report, [recorder])
    recorder.close()
    (error,) = report.errors
    assert error.code.name == "simulation-tipped"
    assert "fell over to its right after 1." in error.message
    assert "lower its speed" in (error.hint or "")
    assert not result.completed
    rows = read(tmp_path / "records/cart.csv")
    assert float(rows[-1]["time"]) == pytest.approx(result.run.simulated)


def test_a_start_inside_an_obstacle_has_its_own_hint(tmp_path: Path) -> None:
    kerb = "{from: [0.55, -2], to: [0.55, 2], height: 0.15, width: 1.2}"
    drive = simulation(tmp_path, HEAD + f"world: {{kerbs: [{kerb}]}}\n")
    report = Report()
    drive.play(report, [])
    assert "start inside an obstacle" in (report.errors[0].hint or "")


def test_records_have_the_groups_and_times_of_the_scenario(tmp_path: Path) -> None:
    text = HEAD + "record: {what: [truth, joints], every: 0.1 s}\n"
    drive = simulation(tmp_path, text)
    scenario = drive.scenario
    recorder = CsvRecorder(tmp_path / "r", [*drive.robots.items()], scenario.record, scenario.every)
    drive.play(Report(), [recorder])
    recorder.close()
    rows = read(tmp_path / "r/cart.csv")
    assert len(rows) == 41
    assert {"true_x", "fl_drive_axle.position"} <= rows[0].keys()
    assert not any(name.startswith(("odometry", "asked")) for name in rows[0])
    # The angle of a driven wheel is the distance over its radius.
    distance = float(rows[-1]["true_x"])
    angle = float(rows[-1]["fl_drive_axle.position"]) - float(rows[0]["fl_drive_axle.position"])
    assert angle * 0.2 == pytest.approx(distance, rel=0.01)


def test_rough_ground_has_its_amplitude_and_is_level_at_the_start() -> None:
    ground = Ground(amplitude=0.02, wavelength=1.0, seed=5, size=(20.0, 10.0))
    rows = relief_of(ground, [Pose((2.0, 1.0, 0.0))]).rows
    inner = [h for row in rows[20:-20] for h in row[20:-20]]
    assert 0.0 <= min(inner) < 0.3
    assert 0.7 < max(inner) <= 1.0
    x, y = round((2.0 + 10.0) * 10), round((1.0 + 5.0) * 10)
    assert {rows[y + dy][x + dx] for dx in range(-9, 10) for dy in range(-9, 10)} == {0.5}
    assert rows[0][5] == rows[5][0] == 0.0
    assert relief_of(ground, []).rows == relief_of(ground, []).rows
    other = Ground(0, 0, 0.02, 1.0, 6, (20.0, 10.0))
    assert relief_of(other, []).rows != relief_of(ground, []).rows


def test_divergence_is_reported_with_time_and_cause(tmp_path: Path) -> None:
    drive = simulation(tmp_path, HEAD)

    def on_tick(loop: Any) -> None:
        if loop.driver.state.time >= 1.0:
            loop.scene.data.qvel[7] = 1e7

    report = Report()
    result = drive.play(report, on_tick=on_tick)
    (error,) = report.errors
    assert error.code.name == "simulation-diverged"
    assert "after 1.0" in error.message
    assert "the joint `cart/" in error.message
    assert not result.passed


def test_an_interrupted_run_leaves_complete_records(tmp_path: Path) -> None:
    drive = simulation(tmp_path, HEAD)
    recorder = CsvRecorder(tmp_path / "r", [*drive.robots.items()], drive.scenario.record)

    def on_tick(loop: Any) -> None:
        if loop.driver.state.time >= 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive.play(Report(), [recorder], on_tick)
    recorder.close()
    rows = read(tmp_path / "r/cart.csv")
    assert float(rows[-1]["time"]) == 1.0
    assert all(None not in row.values() for row in rows)
