"""IMU and GNSS against closed forms, and their errors against the numbers of the modules."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.sensors import local
from tests.simulation.sensors.rover import simulation
from thorvaldc.diagnostics import Report
from thorvaldc.runtime.se2 import Pose2
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.sensors.gnss import geodetic

IMU, GNSS = "rover/imu", "rover/gnss"
G = 9.81


def readings(run: Any, name: str) -> list[Any]:
    """Returns the measurements of a sensor during a scenario."""
    measured: list[Any] = []
    run.sensors.listeners.append(lambda s, m: measured.append(m) if s.name == name else None)
    run.play(Report())
    return measured


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def wxyz(reading: Any) -> list[float]:
    return [reading.orientation.w, *xyz(reading.orientation)]


def drive(vx: float, wz: float) -> str:
    return f"script: [{{at: 0, vx: {vx}, wz: {wz}}}]\n"


def test_an_imu_at_rest_measures_gravity(tmp_path: Path) -> None:
    reading = readings(simulation(tmp_path, drive(0.0, 0.0)), IMU)[-1]
    assert xyz(reading.linear_acceleration) == pytest.approx([0.0, 0.0, G], abs=0.02)
    assert xyz(reading.angular_velocity) == pytest.approx([0.0] * 3, abs=1e-6)
    assert wxyz(reading) == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-4)


def test_an_imu_on_a_slope_measures_its_tilt(tmp_path: Path) -> None:
    run = simulation(tmp_path, "world: {ground: {type: slope, angle: 10 deg, direction: 0}}\n")
    seen, reading = run.sensors[IMU].seen, run.sensors[IMU].measure()[0]
    tilt = math.radians(10.0)
    force = [-G * math.sin(-tilt), 0.0, G * math.cos(tilt)]
    assert xyz(reading.linear_acceleration) == pytest.approx(force, abs=0.05)
    # Uphill along x: the nose is up, which is a negative turn about y.
    expected = (math.cos(tilt / 2), 0.0, -math.sin(tilt / 2), 0.0)
    assert wxyz(reading) == pytest.approx(expected, abs=2e-3)
    up = seen.level @ np.array([5.0, 0.0, 0.0])
    assert up == pytest.approx([5.0 * math.cos(tilt), 0.0, 5.0 * math.sin(tilt)])


def test_an_imu_on_a_circle_measures_yaw_rate_and_centripetal_acceleration(tmp_path: Path) -> None:
    vx, wz = 0.6, 0.4
    run = simulation(tmp_path, drive(vx, wz))
    reading = readings(run, IMU)[-1]
    x = run.sensors[IMU].mount()[0]  # behind base_link, which moves along x
    assert reading.angular_velocity.z == pytest.approx(wz, rel=0.01)
    assert xyz(reading.linear_acceleration)[:2] == pytest.approx([-(wz**2) * x, vx * wz], abs=0.02)


def test_an_imu_measures_the_acceleration_of_a_ramp(tmp_path: Path) -> None:
    measured = readings(simulation(tmp_path, drive(0.8, 0.0)), IMU)
    speed = sum((m.linear_acceleration.x for m in measured), 0.0) / 100.0
    assert speed == pytest.approx(0.8, abs=0.01)


def test_errors_of_an_imu_are_those_of_the_module(tmp_path: Path) -> None:
    run = simulation(tmp_path, sensors="sensors: {errors: 3}\n")
    imu = run.sensors[IMU]
    taken = [imu.measure()[0] for _ in range(4000)]
    gyro = np.array([xyz(m.angular_velocity) for m in taken])
    force = np.array([xyz(m.linear_acceleration) for m in taken])
    assert gyro.std(axis=0) == pytest.approx([3 * 0.00015 * 10.0] * 3, rel=0.05)
    assert force.std(axis=0) == pytest.approx([3 * 0.001 * 10.0] * 3, rel=0.05)
    # The variances are those of the module, whatever the errors of the scenario are.
    assert taken[0].angular_velocity_covariance[8] == pytest.approx((0.00015 * 10.0) ** 2)
    assert taken[0].orientation_covariance[0] == pytest.approx(math.radians(1.0) ** 2)
    filters = replace(imu.settings, for_filters=True)
    imu.settings = filters
    reading = imu.measure()[0]
    n = np.arange(-(10**5), 10**5)  # the sum of the autocorrelation over all lags
    lasting = np.exp(-abs(n) * 0.01 / 10.0).sum()
    assert reading.orientation_covariance[4] == pytest.approx(math.radians(1.0) ** 2 * lasting)
    # A bias lasts for the whole drive, which counts as 15 s, in both directions of time.
    bias = 2.0 * 15.0 / 0.01 * math.radians(0.01) ** 2
    assert reading.angular_velocity_covariance[0] == pytest.approx((0.00015 * 10.0) ** 2 + bias)


@pytest.mark.slow
def test_biases_of_an_imu_are_those_of_the_module(tmp_path: Path) -> None:
    params = "gyro_noise: 0, accelerometer_noise: 0, accelerometer_bias: 0.002 m/s^2"
    imu = f"  imu: {{type: sensor/imu, mount: frame.rear_center, params: {{{params}}}}}\n"
    runs = [
        simulation(tmp_path, f"noise: {{seed: {n}}}\n", imu, sensors="sensors: {errors: 2}\n")
        for n in range(60)
    ]
    first, second = ([run.sensors[IMU].measure()[0] for run in runs] for _ in range(2))
    gyro = np.array([xyz(m.angular_velocity) for m in first])
    force = np.array([xyz(m.linear_acceleration) for m in first])
    assert gyro.std() == pytest.approx(2 * math.radians(0.01), rel=0.2)
    assert force.std(axis=0).mean() == pytest.approx(2 * 0.002, rel=0.2)
    assert force.mean(axis=0) == pytest.approx([0.0, 0.0, G], abs=0.002)
    # A bias lasts for the whole run.
    assert [xyz(m.angular_velocity) for m in second] == pytest.approx(gyro)


@pytest.mark.slow
def test_errors_of_the_orientation_last(tmp_path: Path) -> None:
    imu = (
        "  imu: {type: sensor/imu, mount: frame.rear_center, params:"
        " {rate: 10 Hz, orientation_accuracy: 2 deg, orientation_time: 1 s}}\n"
    )
    keys, sensors = drive(0.0, 0.0), "sensors: {errors: 1}\n"
    run = simulation(tmp_path, keys, imu, sensors=sensors, duration=400.0)
    yaw = np.array([2.0 * m.orientation.z for m in readings(run, IMU)])
    assert yaw.std() == pytest.approx(math.radians(2.0), rel=0.15)
    correlation = (yaw[10:] * yaw[:-10]).mean() / yaw.var()
    assert correlation == pytest.approx(math.exp(-1.0), abs=0.12)


def test_the_gyro_of_a_scenario_replaces_that_of_the_module(tmp_path: Path) -> None:
    run = simulation(tmp_path, "noise: {gyro: 0.02, gyro_bias: 0.1}\n")
    imu = run.sensors[IMU]
    rates = np.array([imu.measure()[0].angular_velocity.z for _ in range(2000)])
    assert rates.mean() == pytest.approx(0.1, abs=0.002)
    assert rates.std() == pytest.approx(0.02, rel=0.05)


def test_an_imu_without_orientation_says_so(tmp_path: Path) -> None:
    imu = "  imu: {type: sensor/imu, mount: frame.rear_center, params: {orientation_accuracy: 0}}\n"
    run = simulation(tmp_path, modules=imu)
    assert run.sensors[IMU].measure()[0].orientation_covariance[0] == -1.0


@pytest.mark.parametrize(
    "position", [(0, 0, 0), (3, -2, 1.5), (-4000, 2500, -20), (9e4, -1e5, 300)]
)
def test_geodetic_coordinates_read_back(position: tuple[float, ...]) -> None:
    assert local(*geodetic(np.array(position, float))) == pytest.approx(position, abs=1e-6)


def test_a_fix_is_the_place_of_the_antenna(tmp_path: Path) -> None:
    run = simulation(tmp_path)
    base = MujocoBase(next(iter(run.robots.values())), run.scene)
    base.place(Pose2(10.0, -4.0, 0.7))
    run.sensors[GNSS].seen.update()
    fix = run.sensors[GNSS].measure()[0]
    x, y, z = run.sensors[GNSS].mount()[:3]
    c, s = math.cos(0.7), math.sin(0.7)
    expected = [10.0 + c * x - s * y, -4.0 + s * x + c * y, z]
    assert local(fix.latitude, fix.longitude, fix.altitude) == pytest.approx(expected, abs=0.01)
    assert (x, y) == (pytest.approx(0.3, abs=1e-3), pytest.approx(0.2, abs=1e-3))


@pytest.mark.slow
def test_errors_of_a_fix_wander(tmp_path: Path) -> None:
    params = "{accuracy: 20 mm, wander: 0.6, wander_time: 2 s, rate: 5 Hz}"
    gnss = f"  gnss: {{type: sensor/gnss_antenna, mount: {{parent: frame}}, params: {params}}}\n"
    sensors = "sensors: {errors: 1}\n"
    run = simulation(tmp_path, drive(0.0, 0.0), gnss, sensors=sensors, duration=600.0)
    measured = readings(run, GNSS)
    errors = np.array([local(m.latitude, m.longitude, m.altitude)[:2] for m in measured])
    errors -= errors.mean(axis=0)
    assert errors.std() == pytest.approx(0.02, rel=0.1)
    for lag in (1, 5, 10):
        correlation = (errors[lag:] * errors[:-lag]).mean() / errors.var()
        assert correlation == pytest.approx(0.6 * math.exp(-lag * 0.2 / 2.0), abs=0.1)
    assert measured[0].position_covariance[0] == pytest.approx(0.02**2)


def test_two_receivers_have_different_errors(tmp_path: Path) -> None:
    gnss = "".join(
        f"  {name}: {{type: sensor/gnss_antenna, mount: {{parent: frame, xyz: [{x}, 0, 0.1]}}}}\n"
        for name, x in (("a", 0.2), ("b", -0.2))
    )
    run = simulation(tmp_path, "", gnss, sensors="sensors: {errors: 1}\n")
    a, b = (run.sensors[f"rover/{name}"].measure()[0] for name in "ab")
    assert abs(a.altitude - b.altitude) > 1e-6


def test_a_receiver_that_states_no_accuracy_has_no_known_covariance(tmp_path: Path) -> None:
    gnss = "  gnss: {type: sensor/gnss_antenna, mount: {parent: frame}, params: {accuracy: 0}}\n"
    fix = simulation(tmp_path, "", gnss).sensors[GNSS].measure()[0]
    assert fix.position_covariance_type == 0
