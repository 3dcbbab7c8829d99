"""Sensor noise of a scenario: a gyro for robots with an IMU, encoders with whole counts."""

from __future__ import annotations

import math
import statistics
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.scenario_run import ScenarioResult, ScenarioSimulation

ROBOT = """thorvaldc: 1
name: cart
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.2 m, width: 800 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
"""
IMU = "  imu: {type: sensor/imu, mount: frame.front_center}\n"
SCENARIO = """thorvaldc: 1
scenario: trial
robots: {cart: {robot: cart.yaml}}
duration: 6 s
script: [{at: 0, vx: 0.6 m/s, wz: 0.2}]
"""


def played(folder: Path, keys: str, imu: bool = True) -> tuple[ScenarioResult, list[Any]]:
    """Returns the result, and per tick the joint readings and the true yaw rate."""
    (folder / "cart.yaml").write_text(ROBOT + (IMU if imu else ""))
    (folder / "s.yaml").write_text(SCENARIO + keys)
    compilation = compile_file(folder / "s.yaml")
    assert compilation.scenario is not None, [d.message for d in compilation.report]
    simulation = ScenarioSimulation(
        compilation.scenario, emit(compilation.scenario.fleet, ["mjcf"])
    )
    readings: list[Any] = []
    result = simulation.play(
        Report(), on_tick=lambda m: readings.append((m.sample().joints, m.sample().true.wz))
    )
    return result, readings


def test_a_gyro_measures_the_yaw_rate_with_its_errors(tmp_path: Path) -> None:
    _, readings = played(tmp_path, "noise: {gyro: 0.02 rad/s, gyro_bias: 0.1 rad/s, seed: 3}\n")
    errors = [joints.yaw_rate - true for joints, true in readings]
    assert statistics.mean(errors) == pytest.approx(0.1, abs=0.005)
    assert statistics.stdev(errors) == pytest.approx(0.02, rel=0.15)
    _, readings = played(tmp_path, "noise: {gyro_bias: 0}\n")
    assert all(joints.yaw_rate == pytest.approx(true, abs=1e-9) for joints, true in readings)


def test_there_is_no_yaw_rate_without_gyro_noise_or_without_an_imu(tmp_path: Path) -> None:
    _, readings = played(tmp_path, "noise: {wheel_speed: 0.1}\n")
    assert {joints.yaw_rate for joints, _ in readings} == {None}
    _, readings = played(tmp_path, "noise: {gyro: 0.1}\n", imu=False)
    assert {joints.yaw_rate for joints, _ in readings} == {None}


def test_a_good_gyro_improves_the_odometry_and_a_bad_one_degrades_it(tmp_path: Path) -> None:
    fault = "faults: [{type: steering_offset, wheel: fl_wheel, angle: 2 deg}]\n"
    without = played(tmp_path, fault)[0].metrics["cart"]["yaw_error"]
    good = played(tmp_path, fault + "noise: {gyro: 0.001 rad/s}\n")[0].metrics["cart"]["yaw_error"]
    assert good < 0.75 * without  # limited by the weight that the driver gives the gyro
    biased = played(tmp_path, "noise: {gyro_bias: 3 deg/s}\n")[0].metrics["cart"]["yaw_error"]
    assert biased > 0.02


def test_equal_seeds_give_equal_noise(tmp_path: Path) -> None:
    text = "noise: {{gyro: 0.1 deg/s, encoder_counts: true, seed: {}}}\n"
    first = played(tmp_path, text.format(1))[0].hash
    assert played(tmp_path, text.format(1))[0].hash == first
    assert played(tmp_path, text.format(2))[0].hash != first


def test_encoders_have_whole_counts(tmp_path: Path) -> None:
    result, readings = played(tmp_path, "noise: {encoder_counts: true}\n")
    robot = compile_file(tmp_path / "cart.yaml").model
    drive = robot.actuator_of(robot.wheels[0].spin_joint)  # type: ignore[union-attr]
    steering = robot.actuator_of(robot.wheels[0].steering_joint)  # type: ignore
    for motor, values in (
        (drive, [joints.positions[0] for joints, _ in readings]),
        (steering, [joints.angles[0] for joints, _ in readings]),
    ):
        count = math.tau / (4 * motor.encoder_ppr * motor.gear_ratio)
        counts = [value / count for value in values]
        assert counts == pytest.approx([round(c) for c in counts], abs=1e-6)
        assert len(set(counts)) > 10
    assert result.metrics["cart"]["end_error"] < 0.02
