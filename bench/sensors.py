"""Sensors in the simulation: what they cost, a map of a drive, and the consistency of an EKF.

Cost: a run with sensors compared with the same run without, and a scan of each lidar.

Map: an occupancy grid of the scans of a drive in a room, at the poses of the odometry.

Filter: the EKF of robot_localization (``bench.filters``) with the inputs of the generated
``gnss.yaml``: the twists of the odometry with the covariance for filters, yaw and yaw rate of the
IMU, and positions of GNSS.  The radii and the steering zeros of each run are wrong, as in
``bench.consistency``.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.consistency import BIASED, KINDS
from bench.figure import EXAMPLE, Figure, least_times
from bench.filters import YAW, YAW_RATE, PlanarEkf
from bench.wheel_noise import Array
from thorvaldc.backends.ros2_parameters import process_noise
from thorvaldc.compiler.pipeline import compile_file, emit, load
from thorvaldc.model import Robot
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.model.sensor_numbers import WORLD_ORIGIN
from thorvaldc.runtime.odometry import filter_covariance
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import ControlLoop, Segment
from thorvaldc.simulation.physics.sim_base import WheelErrors
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.sensors.gnss import Fix
from thorvaldc.simulation.sensors.imu import ImuReading
from thorvaldc.simulation.sensors.simulated_sensor import Measurement, SimulatedSensor
from thorvaldc.simulation.simulation_run import Simulation

RUNS, SECONDS = 16, 40.0
SETTLED = 10.0
"""Time (s) from which NEES counts, once a second."""
DRIVE = [
    Segment(t, Twist(*twist))
    for t, twist in [
        (0.0, (0.6, 0.0, 0.2)),
        (8.0, (0.6, 0.0, -0.3)),
        (16.0, (0.5, 0.2, 0.0)),
        (22.0, (0.3, 0.0, 0.5)),
        (30.0, (0.6, -0.1, -0.1)),
    ]
]


Event = tuple[str, float, list[float], Array]
"""Kind, time in s, values, covariance."""


def events_of(robot: Robot, files: Mapping[str, bytes], seed: int) -> list[Event]:
    """Returns the inputs of a filter and the true poses during a drive with wrong wheels."""
    rng, noise = np.random.default_rng(seed), KINDS[BIASED]
    n, radius_error = len(robot.wheels), noise.radius_error or 0.0
    ratios = 1.0 + rng.normal(0.0, radius_error, n)
    offsets = rng.normal(0.0, noise.steering_offset_error or 0.0, n)
    errors = {robot.name: WheelErrors(tuple(ratios), tuple(offsets))}
    settings = SensorSettings(seed=seed, for_filters=True)
    simulation = Simulation(robot, files, wheel_errors=errors, sensors=settings)
    receiver = next(sensor for sensor in robot.sensors if sensor.type == "gnss").name
    events: list[Event] = []

    def measured(sensor: SimulatedSensor, m: Measurement) -> None:
        if isinstance(m, ImuReading) and m.orientation is not None:
            w, x, y, z = m.orientation
            yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            variances = np.diag([m.orientation_variance, m.angular_velocity_variance])
            events.append(("imu", m.time, [yaw, float(m.angular_velocity[2])], variances))
        elif isinstance(m, Fix) and sensor.name == receiver:
            east, north, _ = local(m.latitude, m.longitude, m.altitude)
            values = [float(east), float(north), *m.mount[:2]]
            events.append(("gnss", m.time, values, m.variance * np.eye(2)))

    def ticked(loop: ControlLoop) -> None:
        sample, state = loop.sample(), loop.driver.state
        estimator, period = loop.driver.calculator.estimator, 1.0 / robot.driver.rate
        covariance = filter_covariance(estimator, state.joints, state.odometry, period)
        events.append(("odometry", sample.time, [*sample.estimated], np.array(covariance)))
        events.append(("truth", sample.time, [*sample.pose_true], np.zeros(0)))

    simulation.sensors.listeners.append(measured)
    simulation.run(SECONDS, DRIVE, on_tick=ticked)
    return events


def filtered(robot: Robot, inputs: tuple[str, ...], runs: int = RUNS) -> Array:
    """Returns NEES/3 (runs, times) of the EKF with the odometry and ``inputs``."""
    files = emit(robot, ["mjcf"])
    all_events = [events_of(robot, files, seed) for seed in range(runs)]
    ekf, last, results = PlanarEkf(runs, process_noise(robot)), 0.0, []
    for same in zip(*all_events, strict=True):
        kind, now = same[0][:2]
        values = np.array([event[2] for event in same])
        covariances = np.array([event[3] for event in same])
        if kind == "truth":
            if now >= SETTLED and now % 1.0 < 1e-6:
                results.append(ekf.nees(values))
            continue
        if kind != "odometry" and kind not in inputs:
            continue
        ekf.predict(now - last)
        last = now
        if kind == "odometry":
            ekf.correct([3, 4, 5], values, covariances)
        elif kind == "imu":
            ekf.correct([YAW, YAW_RATE], values, covariances)
        else:  # as navsat_transform: from the antenna to base_link, with the yaw of the filter
            c, s = np.cos(ekf.state[:, YAW]), np.sin(ekf.state[:, YAW])
            x, y = values[:, 2], values[:, 3]
            antenna = np.stack([c * x - s * y, s * x + c * y], axis=1)
            ekf.correct([0, 1], values[:, :2] - antenna, covariances)
    return np.array(results).T


def with_gnss(robot: Robot, wander: float) -> Robot:
    """Returns a robot whose GNSS receivers have the share ``wander`` of slow errors."""
    sensors = [
        replace(s, properties=(*(p for p in s.properties if p[0] != "wander"), ("wander", wander)))
        if s.type == "gnss"
        else s
        for s in robot.sensors
    ]
    return replace(robot, sensors=tuple(sensors))


def local(latitude: float, longitude: float, height: float) -> Array:
    """Returns a position (3) on WGS 84 (deg, m) as east, north and up of the origin in m."""
    lat, lon = (math.radians(angle) for angle in WORLD_ORIGIN[:2])
    sin, cos = math.sin, math.cos
    axes = np.array(
        [
            [-sin(lon), cos(lon), 0.0],
            [-sin(lat) * cos(lon), -sin(lat) * sin(lon), cos(lat)],
            [cos(lat) * cos(lon), cos(lat) * sin(lon), sin(lat)],
        ]
    )
    result: Array = axes @ (_cartesian(latitude, longitude, height) - _cartesian(*WORLD_ORIGIN))
    return result


def _cartesian(latitude: float, longitude: float, height: float) -> Array:
    a, e2 = 6378137.0, 0.0066943799901413165
    lat, lon = math.radians(latitude), math.radians(longitude)
    n = a / math.sqrt(1.0 - e2 * math.sin(lat) ** 2)
    across = (n + height) * math.cos(lat)
    along = (n * (1.0 - e2) + height) * math.sin(lat)
    return np.array([across * math.cos(lon), across * math.sin(lon), along])
