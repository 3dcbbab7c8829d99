"""Sensors on odd mounts of a fleet: what a reader of the record computes with the frames in it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from bench.sensors import local
from tests.simulation.sensors.rover import ROBOT
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model.plugins import data_folder
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.scenario_run import ScenarioSimulation

SENSORS = """\
  scan:
    type: sensor/lidar_2d
    mount: {parent: fl.steering, xyz: [0.3 m, 0, 0.1 m], rpy: [5 deg, -10 deg, 30 deg]}
    params: {rate: 10 Hz}
  tower:
    type: sensor/lidar_3d
    mount: {parent: frame, xyz: [-0.3 m, 0.1 m, 0.5 m], rpy: [0, 20 deg, 45 deg]}
    params: {angular_resolution: 2 deg}
  imu:
    type: sensor/imu
    mount: {parent: frame, xyz: [0, 0.2 m, 0], rpy: [180 deg, 0, 90 deg]}
  near: {type: sensor/gnss_antenna, mount: {parent: frame, xyz: [0.5 m, 0.3 m, 0.1 m]}}
  far:
    type: sensor/gnss_antenna
    mount: {parent: frame, xyz: [-0.5 m, -0.3 m, 0.1 m], rpy: [10 deg, 0, 0]}
    params: {accuracy: 20 mm, rate: 5 Hz}
"""
SCENARIO = """thorvaldc: 1
scenario: odd
robots:
  a: {robot: rover.yaml}
  b: {robot: rover.yaml, xyz: [1.5 m, 4.6 m, 0], yaw: 20 deg}
duration: 2 s
sensors: {errors: 0}
script: [{at: 0, vx: 0.5, wz: 0.3}]
world:
  obstacles:
    wall: {shape: box, xyz: [6 m, 0, 0], size: [0.2 m, 30 m, 9 m]}
    post: {shape: cylinder, xyz: [0, -3 m, 0], diameter: 0.3 m, height: 5 m}
"""


def robot_with_brackets(folder: Path) -> None:
    """Writes a robot whose front left steering module has a place for a sensor that it turns."""
    library = folder / "library"
    for name in ("steering/standard", "assembly/steered_drive"):
        shutil.copytree(data_folder("modules") / name, library / f"{name}_mine")
    steering = library / "steering/standard_mine/module.yaml"
    place = "free_mount: {kind: sensor_mount, link: flange}\n"
    steering.write_text(steering.read_text() + place)
    assembly = library / "assembly/steered_drive_mine/module.yaml"
    assembly.write_text(assembly.read_text().replace("steering/standard", "steering/standard_mine"))
    text = ROBOT.replace(
        "fl: {type: assembly/steered_drive", "fl: {type: assembly/steered_drive_mine"
    )
    (folder / "rover.yaml").write_text("library: [library]\n" + text + SENSORS)


class Record:
    """The messages of a record by topic, and the poses of frames in the frame ``map``."""

    def __init__(self, path: Path) -> None:
        self.messages: dict[str, list[Any]] = {}
        self._frames: dict[tuple[str, int], tuple[str, Any]] = {}
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            for connection, time, data in reader.messages():
                message: Any = reader.deserialize(data, connection.msgtype)
                self.messages.setdefault(connection.topic, []).append((time, message))
                for t in getattr(message, "transforms", ()):
                    time = -1 if connection.topic == "/tf_static" else time
                    self._frames[t.child_frame_id, time] = t.header.frame_id, matrix(t.transform)

    def pose(self, frame: str, time: int) -> Any:
        """Returns the true pose (4, 4) of a frame of a robot at the time of a control cycle."""
        result = np.eye(4)
        while frame != "map":
            frame += "_true" if frame.endswith("/base_link") else ""
            fixed = self._frames.get((frame, -1))
            frame, step = fixed or self._frames[frame, time]
            result = step @ result
        return result


def matrix(transform: Any) -> Any:
    result, t = np.eye(4), transform.translation
    result[:3, :3], result[:3, 3] = rotation(transform.rotation), (t.x, t.y, t.z)
    return result


def rotation(q: Any) -> Any:
    w, v = q.w, np.array([q.x, q.y, q.z])
    cross = np.cross(np.eye(3), v)
    return (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Record:
    folder = tmp_path_factory.mktemp("odd")
    robot_with_brackets(folder)
    (folder / "odd.yaml").write_text(SCENARIO)
    compilation = compile_file(folder / "odd.yaml")
    assert compilation.scenario is not None, [d.message for d in compilation.report]
    run = ScenarioSimulation(compilation.scenario, emit(compilation.scenario.fleet, ["mjcf"]))
    recorder = McapRecorder(folder / "odd.mcap", [*run.robots.items()], ("odometry", "truth"))
    run.play(Report(), [recorder])
    recorder.close()
    return Record(folder / "odd.mcap")


def on_obstacles(points: Any) -> int:
    """Checks the points (3, n) that are on wall and post, and returns their number."""
    x, y = points[:2, points[2] > 0.1]
    wall, post = x > 5.0, np.hypot(x, y + 3.0) < 0.5
    assert x[wall] == pytest.approx(5.9, abs=1e-5)
    assert np.hypot(x, y + 3.0)[post] == pytest.approx(0.15, abs=1e-5)
    assert not ((y < -1.0) & ~wall & ~post).any()
    return int(wall.sum() + post.sum())


@pytest.mark.parametrize("robot", ["a", "b"])
def test_scans_and_points_are_on_the_obstacles(record: Record, robot: str) -> None:
    hits = 0
    for time, scan in record.messages[f"/{robot}/scan/scan"]:
        assert (scan.range_min, scan.range_max) == pytest.approx((0.05, 25.0))
        assert (scan.scan_time, scan.time_increment) == pytest.approx((0.1, 0.0))
        angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        assert angles[-1] == pytest.approx(scan.angle_max, abs=1e-4)
        assert len(scan.intensities) == 0
        hit = np.isfinite(scan.ranges)
        r, c, s = scan.ranges[hit], np.cos(angles[hit]), np.sin(angles[hit])
        points = np.stack([r * c, r * s, 0.0 * r, np.ones(len(r))])
        hits += on_obstacles((record.pose(scan.header.frame_id, time) @ points)[:3])
    assert hits > 500
    hits = 0
    layers = np.linspace(-15.0, 15.0, 16)
    for time, cloud in record.messages[f"/{robot}/tower/points"]:
        points = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(-1, 3).T.astype(float)
        elevations = np.degrees(np.arcsin(points[2] / np.linalg.norm(points, axis=0)))
        assert abs(elevations[:, np.newaxis] - layers).min(axis=1).max() < 1e-3
        points = np.vstack([points, np.ones(points.shape[1])])
        hits += on_obstacles((record.pose(cloud.header.frame_id, time) @ points)[:3])
    assert hits > 5000


@pytest.mark.parametrize("robot", ["a", "b"])
def test_an_imu_that_hangs_upside_down(record: Record, robot: str) -> None:
    readings = record.messages[f"/{robot}/imu/data"][::2]  # those of the control cycles
    for time, reading in readings:
        pose = record.pose(reading.header.frame_id, time)[:3, :3]
        assert rotation(reading.orientation) == pytest.approx(pose, abs=1e-9)
    rate, force = (
        pose @ [v.x, v.y, v.z] for v in (reading.angular_velocity, reading.linear_acceleration)
    )
    assert rate == pytest.approx([0.0, 0.0, 0.3], abs=0.01)
    assert force[2] == pytest.approx(9.81, abs=0.05)
    force = readings[0][1].linear_acceleration
    assert [force.x, force.y, force.z] == pytest.approx([0.0, 0.0, -9.81], abs=0.05)


@pytest.mark.parametrize("robot", ["a", "b"])
def test_fixes_are_those_of_each_antenna(record: Record, robot: str) -> None:
    for name, accuracy, count in (("near", 0.01, 21), ("far", 0.02, 11)):
        fixes = record.messages[f"/{robot}/{name}/fix"]
        assert len(fixes) == count
        for time, fix in fixes:
            place = record.pose(fix.header.frame_id, time)[:3, 3]
            assert local(fix.latitude, fix.longitude, fix.altitude) == pytest.approx(
                place, abs=1e-6
            )
            assert fix.position_covariance == pytest.approx(accuracy**2 * np.eye(3).ravel())
            assert (fix.position_covariance_type, fix.status.status) == (2, 2)
