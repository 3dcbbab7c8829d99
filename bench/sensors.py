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
from typing import NamedTuple

import numpy as np

from bench.consistency import BIASED, KINDS
from bench.figure import EXAMPLE, Figure, in_turns
from bench.filters import YAW, YAW_RATE, PlanarEkf
from bench.wheel_noise import Array
from thorvaldc.backends.ros2_parameters import process_noise
from thorvaldc.compiler.pipeline import compile_file, emit, load
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.scenario import Noise as Errors
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.model.sensor_numbers import WORLD_ORIGIN
from thorvaldc.runtime.filter_covariance import filter_covariance
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import ControlLoop, Segment
from thorvaldc.simulation.physics.sim_base import WheelErrors
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.sensors.lidar import Lidar
from thorvaldc.simulation.sensors.simulated_sensor import Message, SimulatedSensor
from thorvaldc.simulation.simulation_run import Simulation

GROUP = "long"

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
    settings = SensorSettings(for_filters=True, noise=Errors(seed))
    simulation = Simulation(robot, files, wheel_errors=errors, sensors=settings)
    receiver = next(sensor for sensor in robot.sensors if sensor.type == "gnss").name
    events: list[Event] = []

    def measured(sensor: SimulatedSensor, m: Message) -> None:
        now = stamp(m)
        if sensor.sensor.type == "imu":
            q = m.orientation
            yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
            variances = m.orientation_covariance[8], m.angular_velocity_covariance[8]
            events.append(("imu", now, [yaw, m.angular_velocity.z], np.diag(variances)))
        elif sensor.name == receiver:
            east, north, _ = local(m.latitude, m.longitude, m.altitude)
            values = [float(east), float(north), *sensor.mount()[:2]]
            events.append(("gnss", now, values, m.position_covariance[0] * np.eye(2)))

    def ticked(loop: ControlLoop) -> None:
        sample, state = loop.sample(), loop.driver.state
        driver, period = loop.driver, 1.0 / robot.driver.rate
        covariance = filter_covariance(
            *(driver.calculator.estimator, state.joints, state.odometry, period),
            driver.odometry.motion_time,
        )
        events.append(("odometry", sample.time, [*sample.estimated], np.array(covariance)))
        events.append(("truth", sample.time, [*sample.pose_true], np.zeros(0)))

    simulation.sensors.listeners.append(measured)
    simulation.run(SECONDS, DRIVE, on_tick=ticked)
    return events


def stamp(message: Message) -> float:
    """Returns the time of a message in s."""
    time = message.header.stamp
    return float(time.sec + 1e-9 * time.nanosec)


def filtered(robot: Robot, runs: int = RUNS) -> Array:
    """Returns NEES/3 (runs, times) of the EKF with odometry, IMU and GNSS."""
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


# -- a map of a drive ------------------------------------------------------------------------------

ROOM = {
    "north": (0.0, 3.107, 9.0, 0.2),
    "south": (0.0, -3.096, 9.0, 0.2),
    "east": (4.411, 0.0, 0.2, 6.0),
    "west": (-4.395, 0.0, 0.2, 6.0),
    "crate": (3.003, 1.609, 0.8, 0.6),
}
"""Walls of a room and a crate: centre and size along x and y in m."""
CELL = 0.02
"""Edge of a cell of the map in m."""
_HALF = 5.0
_NEIGHBOURS, _SHARE = range(-3, 4), 0.5
"""An occupied cell has this share of the votes of each cell around it: the tails of the errors of
a lidar lie behind a wall, where no ray passes."""
_SCANS_BETWEEN = 10
"""The map has the scan of one of so many control cycles."""


class MapResult(NamedTuple):
    """Largest distance of an occupied cell to the nearest wall, m, the share of the surfaces of
    the walls towards the room that the map has, and the number of occupied cells."""

    error: float
    covered: float
    cells: int


def room_scenario(robot: str, duration: float, errors: float) -> str:
    """Returns a scenario in which the robot drives a circle in the room."""
    walls = "".join(
        f"    {name}: {{shape: box, xyz: [{x}, {y}, 0], size: [{a}, {b}, 2]}}\n"
        for name, (x, y, a, b) in ROOM.items()
    )
    return (
        "thorvaldc: 1\nscenario: room\n"
        f"robots: {{r: {{robot: {robot}, xyz: [0, -1.2, 0]}}}}\nduration: {duration}\n"
        f"sensors: {{errors: {errors}}}\nscript: [{{at: 0, vx: 0.5, wz: 0.45}}]\n"
        f"world:\n  obstacles:\n{walls}"
    )


def mapped(simulation: ScenarioSimulation) -> MapResult:
    """Returns the result of an occupancy grid of the scans at the poses of the odometry.

    A cell gains a vote by each ray that ends in it, and loses one by each ray that passes it.
    """
    n = round(2.0 * _HALF / CELL)
    votes = np.zeros(n * n)
    scans: list[tuple[Message, tuple[float, ...]]] = []
    simulation.sensors.listeners.append(
        lambda s, m: scans.append((m, s.mount())) if s.sensor.type == "lidar_2d" else None
    )

    def ticked(loop: ControlLoop) -> None:
        sample = loop.sample()
        if loop.ticks % _SCANS_BETWEEN == 1 and abs(stamp(scans[-1][0]) - sample.time) < 1e-6:
            _vote(votes, n, *scans[-1], sample.pose_estimated)

    simulation.play(Report(), on_tick=ticked, hashed=False)
    grid = votes.reshape(n, n)
    around = np.max(
        [np.roll(grid, (i, j), (0, 1)) for i in _NEIGHBOURS for j in _NEIGHBOURS], axis=0
    )
    rows, columns = np.nonzero((grid > 2.0) & (grid > _SHARE * around))
    centres = (np.stack([columns, rows], axis=1) + 0.5) * CELL - _HALF
    distances = np.min([_distances(centres, wall) for wall in ROOM.values()], axis=0)
    surface = np.array(list(_surface()))
    gaps = [np.hypot(*(centres - point).T).min() for point in surface]
    covered = float(np.mean(np.array(gaps) < 1.5 * CELL))
    return MapResult(float(distances.max()), covered, len(centres))


def _vote(votes: Array, n: int, scan: Message, mount: tuple[float, ...], pose: Pose2) -> None:
    """Adds the rays of a scan at the pose of ``base_link`` to the votes (n n)."""
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    x, y, _, _, _, qz, qw = mount
    heading = pose.yaw + 2.0 * math.atan2(qz, qw) + angles
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    start = np.array([pose.x + c * x - s * y, pose.y + s * x + c * y])
    hit = np.isfinite(scan.ranges)
    directions = np.stack([np.cos(heading[hit]), np.sin(heading[hit])], axis=1)
    ranges = scan.ranges[hit]
    ends = _cells(start + directions * ranges[:, np.newaxis], n)
    steps = np.arange(0.0, 8.0, CELL / 2)
    points = start + directions[:, np.newaxis] * steps[np.newaxis, :, np.newaxis]
    passing = _cells(points, n)
    before = steps[np.newaxis] < ranges[:, np.newaxis] - CELL
    # A ray votes once for each cell.
    rays = np.arange(len(ranges))[:, np.newaxis] * votes.size
    passed = np.unique((passing + rays)[before & (passing != ends[:, np.newaxis])]) % votes.size
    np.add.at(votes, passed, -1.0)
    np.add.at(votes, ends, 1.0)


def _cells(points: Array, n: int) -> Array:
    index = np.clip(np.floor((points + _HALF) / CELL).astype(int), 0, n - 1)
    return index[..., 1] * n + index[..., 0]


def _distances(points: Array, wall: tuple[float, float, float, float]) -> Array:
    """Returns the distances (n) of points to the outline of a wall."""
    x, y, a, b = wall
    beyond = np.abs(points - [x, y]) - [a / 2, b / 2]
    outside = np.hypot(*np.maximum(beyond, 0.0).T)
    return np.where((beyond < 0.0).all(axis=1), -beyond.max(axis=1), outside)


def _surface() -> Iterator[tuple[float, float]]:
    """Yields points of the walls towards the room, each 0.1 m; nothing behind the crate."""
    top, bottom, right, left = 3.007, -2.996, 4.311, -4.295
    for y in np.arange(bottom + 0.2, top - 0.2, 0.1):
        yield left, y
        if y < 1.2:
            yield right, y
    for x in np.arange(left + 0.1, right - 0.1, 0.1):
        yield x, bottom
        if x < 2.0:
            yield x, top
    for x in np.arange(2.65, 3.38, 0.1):
        yield x, 1.309


def room(robot: Path, folder: Path, seconds: float, errors: float = 1.0) -> ScenarioSimulation:
    """Returns the simulation of a robot that drives a circle in the room."""
    path = folder / "room.yaml"
    path.write_text(room_scenario(str(robot), seconds, errors))
    scenario = compile_file(path).scenario
    assert scenario is not None
    return ScenarioSimulation(scenario, emit(scenario.fleet, ["mjcf"]))


# -- the figures -----------------------------------------------------------------------------------


def costs() -> Iterator[Figure]:
    """Yields what measurements cost, for the example 4WD4WS with its four sensors."""
    robot = load(EXAMPLE)
    files = emit(robot, ["mjcf"])
    plain = Simulation(robot, files)
    with_sensors = Simulation(robot, files, sensors=SensorSettings())
    seconds = 20.0

    def drive(simulation: Simulation) -> None:
        simulation.run(seconds, DRIVE)

    times = in_turns(lambda: drive(plain), lambda: drive(with_sensors), rounds=3)
    without, measured = map(min, times)
    yield Figure(
        "sensors, share of real time",
        (measured - without) / seconds,
        "",
        0.05,
        "lower",
        f"4WD4WS with a 2D lidar (541 rays, 25 Hz), IMU (100 Hz) and two GNSS receivers (10 Hz):"
        f" {measured:.2f} s for {seconds:g} s, without sensors {without:.2f} s",
        timed=True,
    )
    rows = [(s.sensor.type, s) for s in with_sensors.sensors.values()]
    tower = replace(
        next(s for s in robot.sensors if s.type == "lidar_2d"),
        type="lidar_3d",
        properties=(("angular_resolution", math.radians(0.2)), ("range", 100.0)),
    )
    rows.append(("lidar_3d", Lidar(robot, tower, rows[0][1].seen, SensorSettings())))
    for kind, sensor in dict(rows).items():
        count = 200 if kind != "lidar_3d" else 20

        def measure(sensor: SimulatedSensor = sensor, count: int = count) -> None:
            for _ in range(count):
                sensor.measure()

        (times,) = in_turns(measure, rounds=3)
        how = f"{len(sensor.directions)} rays" if isinstance(sensor, Lidar) else "one measurement"
        yield Figure(f"{kind}, one measurement", 1e3 * min(times) / count, "ms", None, "lower", how)


def figures() -> Iterator[Figure]:
    yield from costs()
    with tempfile.TemporaryDirectory() as folder:
        result = mapped(room(EXAMPLE, Path(folder), 16.0))
    how = f"{result.cells} cells of {CELL:g} m, {100 * result.covered:.0f} % of the walls"
    yield Figure("map, largest error of a wall", result.error, "m", 0.02, "lower", how)
    robot = load(EXAMPLE)
    # The filter takes fixes as independent: with errors that last, it is too sure of its position.
    for wander, errors in ((0.0, "white"), (0.5, "half of the variance lasts 60 s")):
        by_run = filtered(with_gnss(robot, wander)).mean(axis=1)
        nees = float(by_run.mean())
        title = f"filter NEES/3 in MuJoCo: odometry, IMU, GNSS, whose errors are {errors}"
        how = f"{RUNS} runs of {SECONDS:g} s, {by_run.min():.1f} to {by_run.max():.1f} in a run"
        yield Figure(title, nees, "", None if wander else 2.0, "lower", how)
        if not wander:
            yield Figure(f"{title}, at least", nees, "", 0.5, "higher", how)
