"""Lidars against closed forms: walls, posts, a slope and rough ground of scenarios."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.simulation.sensors.rover import SENSORS, simulation
from thorvaldc.backends.mjcf_terrain import relief_of
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.runtime.se2 import Pose2
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.sensors.sensor_suite import SensorSuite

WALLS = """
world:
  obstacles:
    wall: {shape: box, xyz: [4.5 m, 0, 0], size: [1 m, 30 m, 3 m]}
    post: {shape: cylinder, xyz: [0, 3 m, 0], diameter: 0.6 m, height: 3 m}
    ball: {shape: sphere, xyz: [0, -3 m, 0.2 m], diameter: 1 m}
"""
CLOUD = """\
  tower:
    type: sensor/lidar_3d
    mount: {parent: frame, xyz: [0, 0, 0.4 m]}
    params: {angular_resolution: 2 deg}
"""


def rays(suite: Any, name: str) -> tuple[Any, Any, Any]:
    """Returns the origin, the directions in the scene, and the exact distances of a lidar."""
    lidar = suite[name]
    lidar.seen.update()
    origin, rotation = lidar.pose()
    return origin, lidar.directions @ rotation.T, lidar.distances()


def circle(origin: Any, direction: Any, centre: Any, radius: float) -> float:
    """Returns the distance along a unit direction to a circle or a sphere; inf beside it."""
    half = np.dot(direction, origin - centre)
    rest = half**2 - np.dot(origin - centre, origin - centre) + radius**2
    return -half - math.sqrt(rest) if rest >= 0.0 and half < 0.0 else math.inf


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.5), (-0.2, 0.4, -2.0)])
def test_distances_to_wall_post_and_ball(tmp_path: Path, start: tuple[float, ...]) -> None:
    run = simulation(tmp_path, WALLS)
    base = MujocoBase(next(iter(run.robots.values())), run.scene)
    base.place(Pose2(*start))
    origin, directions, distances = rays(run.sensors, "rover/lidar")
    hits = 0
    for direction, distance in zip(directions, distances, strict=True):
        flat = direction[:2] / np.hypot(*direction[:2])
        expected = min(
            (4.0 - origin[0]) / direction[0] if direction[0] > 0.0 else math.inf,
            circle(origin[:2], flat, np.array([0.0, 3.0]), 0.3) / np.hypot(*direction[:2]),
            circle(origin, direction, np.array([0.0, -3.0, 0.7]), 0.5),
        )
        # The wall ends at y = +-15 m.
        if expected > 25.0 or abs(origin[1] + expected * direction[1]) > 15.0:
            continue
        assert distance == pytest.approx(expected, abs=1e-6)
        hits += 1
    assert hits > 100


def test_distances_to_level_ground(tmp_path: Path) -> None:
    run = simulation(tmp_path, modules=SENSORS + CLOUD)
    origin, directions, distances = rays(run.sensors, "rover/tower")
    down = directions[:, 2] < -0.02
    expected = -origin[2] / directions[down, 2]
    assert distances[down] == pytest.approx(expected, abs=1e-6)
    assert np.isinf(distances[directions[:, 2] > 0.0]).all()


def test_distances_to_a_slope(tmp_path: Path) -> None:
    # A dam: its side rises by 1 in 5 from x = 3 m on, up to 0.6 m.
    world = """
world: {zones: [{xyz: [8 m, 0, 0], size: [10 m, 10 m], height: 600 mm, slope: 0.19739555984988}]}
"""
    run = simulation(tmp_path, world, SENSORS + CLOUD)
    origin, directions, distances = rays(run.sensors, "rover/tower")
    on_slope = 0
    for (dx, dy, dz), distance in zip(directions, distances, strict=True):
        # z = (x - 3) / 5
        expected = (origin[2] - (origin[0] - 3.0) / 5.0) / (dx / 5.0 - dz)
        x, y = origin[0] + expected * dx, origin[1] + expected * dy
        # A cell at the edges of the side belongs to the neighbouring plane as well.
        if expected > 0.0 and 3.1 < x < 5.9 and abs(y) < 1.9:
            assert distance == pytest.approx(expected, abs=1e-6)
            on_slope += 1
    assert on_slope > 20


def test_points_of_rough_ground_lie_on_its_triangles(tmp_path: Path) -> None:
    world = (
        "world: {ground: {type: rough, amplitude: 60 mm, wavelength: 2 m, size: [20 m, 20 m]}}\n"
    )
    run = simulation(tmp_path, world, SENSORS + CLOUD)
    ground = run.scenario.fleet.world.ground
    grid = np.array(
        relief_of(ground, [p.pose for p in run.scenario.fleet.placements]).rows, np.float32
    )
    z_of = (grid - grid.min()) / (grid.max() - grid.min()) * 2.0 * 0.06 - 0.06
    origin, directions, distances = rays(run.sensors, "rover/tower")
    reached = np.isfinite(distances)
    points = origin + directions[reached] * distances[reached, np.newaxis]
    rows, columns = z_of.shape
    checked = 0
    for x, y, z in points:
        u, v = (x + 10.0) / 20.0 * (columns - 1), (y + 10.0) / 20.0 * (rows - 1)
        i, j = int(u), int(v)
        if not (0.0 < u < columns - 1 and 0.0 < v < rows - 1):
            continue
        a, b, s, t = z_of[j, i], z_of[j, i + 1], u - i, v - j
        c, d = z_of[j + 1, i], z_of[j + 1, i + 1]
        # The diagonal of a cell goes from (0, 0) to (1, 1) or from (1, 0) to (0, 1).
        one = a + s * (b - a) + t * (d - b) if s > t else a + t * (c - a) + s * (d - c)
        other = (
            a + s * (b - a) + t * (c - a)
            if s + t < 1.0
            else d + (1 - s) * (c - d) + (1 - t) * (b - d)
        )
        assert min(abs(one - z), abs(other - z)) < 1e-6
        checked += 1
    assert checked > 500


def test_a_lidar_sees_other_robots_and_not_its_own(tmp_path: Path) -> None:
    run = simulation(tmp_path, modules=SENSORS + CLOUD)
    robots = [*run.robots.values()]
    images = SensorSettings(images=True)  # a scene with visual shapes
    suite = SensorSuite(run.scene, emit(run.scenario.fleet, ["mjcf"]), robots, images)
    for name in ("rover/lidar", "rover/tower"):
        _, directions, distances = rays(run.sensors, name)
        # Only the ground is around: a ray that does not go down returns nothing.
        assert np.isinf(distances[directions[:, 2] > -1e-3]).all()
        # Pictures change nothing.
        assert rays(suite, name)[2] == pytest.approx(distances, abs=1e-9)


def test_two_robots_see_each_other(tmp_path: Path) -> None:
    run = simulation(tmp_path, sensors="sensors: {errors: 0}\n")
    (tmp_path / "trial.yaml").write_text(
        "thorvaldc: 1\nscenario: trial\nduration: 1 s\nsensors: {errors: 0}\n"
        "robots:\n  a: {robot: rover.yaml}\n"
        "  b: {robot: rover.yaml, xyz: [4 m, 0, 0], yaw: 180 deg}\n"
    )
    scenario = compile_file(tmp_path / "trial.yaml").scenario
    assert scenario is not None
    run = ScenarioSimulation(scenario, emit(scenario.fleet, ["mjcf"]))
    for name in ("a/lidar", "b/lidar"):
        distances = rays(run.sensors, name)[2]
        assert 0 < np.isfinite(distances).sum() < len(distances) / 4
        assert distances.min() < 4.0


def test_errors_of_a_scan_are_those_of_the_module(tmp_path: Path) -> None:
    params = "{range_noise: 20 mm, dropouts: 0.1, minimum_range: 2.8 m, range: 5 m}"
    lidar = f"  lidar: {{type: sensor/lidar_2d, mount: frame.front_center, params: {params}}}\n"
    run = simulation(tmp_path, WALLS, lidar, sensors="sensors: {errors: 1}\nnoise: {seed: 3}\n")
    sensor = run.sensors["rover/lidar"]
    exact = sensor.distances()
    scans = np.array([sensor.measure()[0].ranges for _ in range(200)])
    inside = (exact > 2.9) & (exact < 4.8)
    errors = scans[:, inside] - exact[inside]
    kept = np.isfinite(errors)
    assert 1.0 - kept.mean() == pytest.approx(0.1, abs=0.01)
    assert errors[kept].std() == pytest.approx(0.02, rel=0.03)
    assert abs(errors[kept].mean()) < 1e-3
    assert (scans[:, exact > 5.1] == math.inf).all()
    near = exact < 2.7
    assert near.any()
    assert set(np.unique(scans[:, near])) == {-math.inf, math.inf}  # REP 117; lost rays are inf
    assert (scans[:, near] == -math.inf).mean() == pytest.approx(0.9, abs=0.02)
    # Equal seeds give equal errors, other seeds other ones.
    sensor.reset()
    assert (sensor.measure()[0].ranges == scans[0]).all()
    other = simulation(tmp_path, WALLS, lidar, sensors="sensors: {errors: 1}\nnoise: {seed: 4}\n")
    assert (other.sensors["rover/lidar"].measure()[0].ranges != scans[0]).any()
    # Exact measurements have no dropouts either.
    sensor.settings = SensorSettings(errors=0.0)
    assert sensor.measure()[0].ranges[inside] == pytest.approx(exact[inside], rel=1e-6)
