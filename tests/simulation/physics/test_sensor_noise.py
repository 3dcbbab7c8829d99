"""What sensors tell in a scenario: a gyro where there is an IMU, encoders in whole counts."""

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


def played(folder: Path, more: str, imu: bool = True) -> tuple[ScenarioResult, list[Any]]:
    """The result, and at each tick what was told and the true yaw rate."""
    (folder / "cart.yaml").write_text(ROBOT + (IMU if imu else ""))
    (folder / "s.yaml").write_text(SCENARIO + more)
    done = compile_file(folder / "s.yaml")
    assert done.scenario is not None, [d.message for d in done.report]
    simulation = ScenarioSimulation(done.scenario, emit(done.scenario.fleet, ["mjcf"]))
    told: list[Any] = []
    result = simulation.play(
        Report(), on_tick=lambda m: told.append((m.sample().joints, m.sample().true.wz))
    )
    return result, told


def test_a_gyro_tells_the_yaw_rate_with_its_errors(tmp_path: Path) -> None:
    _, told = played(tmp_path, "noise: {gyro: 0.02 rad/s, gyro_bias: 0.1 rad/s, seed: 3}\n")
    off = [joints.yaw_rate - true for joints, true in told]
    assert statistics.mean(off) == pytest.approx(0.1, abs=0.005)
    assert statistics.stdev(off) == pytest.approx(0.02, rel=0.15)
    _, told = played(tmp_path, "noise: {gyro_bias: 0}\n")
    assert all(joints.yaw_rate == pytest.approx(true, abs=1e-9) for joints, true in told)


def test_nobody_tells_it_otherwise(tmp_path: Path) -> None:
    _, told = played(tmp_path, "noise: {wheel_speed: 0.1}\n")
    assert {joints.yaw_rate for joints, _ in told} == {None}
    _, told = played(tmp_path, "noise: {gyro: 0.1}\n", imu=False)
    assert {joints.yaw_rate for joints, _ in told} == {None}


def test_odometry_believes_a_good_gyro_and_suffers_from_a_bad_one(tmp_path: Path) -> None:
    fault = "faults: [{type: steering_offset, wheel: fl_wheel, angle: 2 deg}]\n"
    without = played(tmp_path, fault)[0].metrics["cart"]["yaw_error"]
    good = played(tmp_path, fault + "noise: {gyro: 0.001 rad/s}\n")[0].metrics["cart"]["yaw_error"]
    assert good < 0.75 * without  # as far as the driver trusts it
    biased = played(tmp_path, "noise: {gyro_bias: 3 deg/s}\n")[0].metrics["cart"]["yaw_error"]
    assert biased > 0.02


def test_noise_of_a_gyro_repeats_by_its_seed(tmp_path: Path) -> None:
    text = "noise: {{gyro: 0.1 deg/s, encoder_counts: true, seed: {}}}\n"
    first = played(tmp_path, text.format(1))[0].hash
    assert played(tmp_path, text.format(1))[0].hash == first
    assert played(tmp_path, text.format(2))[0].hash != first


def test_encoders_tell_whole_counts(tmp_path: Path) -> None:
    result, told = played(tmp_path, "noise: {encoder_counts: true}\n")
    robot = compile_file(tmp_path / "cart.yaml").model
    drive = robot.actuator_of(robot.wheels[0].spin_joint)  # type: ignore[union-attr]
    steering = robot.actuator_of(robot.wheels[0].steering_joint)  # type: ignore
    for motor, values in (
        (drive, [joints.positions[0] for joints, _ in told]),
        (steering, [joints.angles[0] for joints, _ in told]),
    ):
        count = math.tau / (4 * motor.encoder_ppr * motor.gear_ratio)
        counts = [value / count for value in values]
        assert counts == pytest.approx([round(c) for c in counts], abs=1e-6)
        assert len(set(counts)) > 10
    assert result.metrics["cart"]["end_error"] < 0.02
