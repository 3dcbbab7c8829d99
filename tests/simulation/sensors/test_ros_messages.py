"""Measurements in a bag, read by readers that are not ours, and the inputs of generated files."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from tests.simulation.sensors.rover import ALL_SENSORS, ROBOT, simulation
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.settings import NAME_PREFIX
from thorvaldc.simulation.records.mcap_writer import McapRecorder

WORLD = """
script: [{at: 0, vx: 0.5, wz: 0.3}]
world: {obstacles: {wall: {shape: box, xyz: [4.5, 0, 0], size: [1, 30, 3]}}}
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Returns a bag of two seconds and its simulation."""
    folder = tmp_path_factory.mktemp("bag")
    run = simulation(folder, WORLD, ALL_SENSORS, duration=2.0)
    recorder = McapRecorder(folder / "run.mcap", [*run.robots.items()], ("odometry", "truth"))
    run.play(Report(), [recorder])
    recorder.close()
    layout = json.loads((folder / "run.foxglove.json").read_text())["configById"]["3D!robots"]
    assert {"/rover/lidar/scan", "/rover/tower/points"} <= layout["topics"].keys()
    return folder / "run.mcap", run


def test_mcap_reads_the_measurements(bag: tuple[Path, Any]) -> None:
    path, run = bag
    messages: dict[str, list[Any]] = {}
    last = 0
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert message.log_time >= last
            last = message.log_time
            if hasattr(decoded, "header"):
                stamp = decoded.header.stamp
                assert stamp.sec * 10**9 + stamp.nanosec == message.log_time
            messages.setdefault(f"{channel.topic} {schema.name}", []).append(decoded)
    scans = messages["/rover/lidar/scan sensor_msgs/msg/LaserScan"]
    assert len(scans) == 51
    assert scans[0].header.frame_id == "rover/lidar_laser"
    ranges = np.array(scans[-1].ranges)
    assert ranges == pytest.approx(run.sensors["rover/lidar"].latest.ranges, rel=1e-6)
    assert np.isfinite(ranges).sum() > 50
    imu = messages["/rover/imu/data sensor_msgs/msg/Imu"][-1]
    reading = run.sensors["rover/imu"].latest
    assert imu.orientation.w == reading.orientation.w
    assert imu.linear_acceleration.z == reading.linear_acceleration.z
    assert tuple(imu.orientation_covariance) == reading.orientation_covariance
    fix = messages["/rover/gnss/fix sensor_msgs/msg/NavSatFix"][-1]
    assert (fix.latitude, fix.altitude) == (
        run.sensors["rover/gnss"].latest.latitude,
        run.sensors["rover/gnss"].latest.altitude,
    )
    info = messages["/rover/camera/camera_info sensor_msgs/msg/CameraInfo"][-1]
    assert info.k[0] == info.p[0] == run.sensors["rover/camera"].latest.k[0]
    frames = {
        t.child_frame_id: (t.header.frame_id, t.transform.translation.x)
        for message in messages["/tf_static tf2_msgs/msg/TFMessage"]
        for t in message.transforms
    }
    frame, x = "rover/lidar_laser", 0.0
    while frame != "rover/base_link":  # links that are not turned
        frame, step = frames[frame]
        x += step
    assert x == pytest.approx(0.476, abs=1e-3)


def tower_points(run: Any) -> Any:
    """Returns the points (n, 3) of the seen scene on the ground."""
    tower = run.sensors["rover/tower"]
    distances = tower.distances()
    distances[distances < 0.5] = np.inf
    kept = np.isfinite(distances)
    return tower.directions[kept] * distances[kept, np.newaxis]


def test_rosbags_reads_the_points(bag: tuple[Path, Any]) -> None:
    path, run = bag
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        connections = [c for c in reader.connections if c.topic == "/rover/tower/points"]
        raw = [data for _, _, data in reader.messages(connections)][-1]
        cloud: Any = reader.deserialize(raw, connections[0].msgtype)
    points = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(-1, 3)
    expected = tower_points(run)
    assert cloud.width == len(points) == len(expected) > 1000
    assert points == pytest.approx(expected, abs=1e-5)
    assert [(f.name, f.offset, f.datatype) for f in cloud.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
    ]


# -- the inputs of the generated files -------------------------------------------------------------


def inputs(values: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yields the path of each parameter that is a topic of the robot, and the topic."""
    if isinstance(values, dict):
        for name, value in values.items():
            yield from inputs(value, f"{path}.{name}")
    elif isinstance(values, str) and values.startswith("/rover/"):
        yield path, values


OF_OTHERS = {
    "/rover/map",
    "/rover/odometry/filtered",
    "/rover/odometry/gps",
    "/rover/cmd_vel_smoothed",
    "/rover/auto_nav/cmd_vel",
    "/rover/local_costmap/published_footprint",
}
"""Topics that nodes of slam_toolbox, robot_localization and Nav2 publish, or their outputs."""
TYPES = {
    "scan_topic": "sensor_msgs/msg/LaserScan",
    "LaserScan": "sensor_msgs/msg/LaserScan",
    "scan": "sensor_msgs/msg/LaserScan",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "pointcloud": "sensor_msgs/msg/PointCloud2",
    "imu0": "sensor_msgs/msg/Imu",
    "imu": "sensor_msgs/msg/Imu",
    "gps/fix": "sensor_msgs/msg/NavSatFix",
    "odom0": "nav_msgs/msg/Odometry",
}
"""Type that a node takes, by the parameter, by the value of a neighbour (`data_type`, `type`), or
by the remapped topic."""


def test_the_topics_satisfy_the_inputs_of_the_generated_files(
    bag: tuple[Path, Any], tmp_path: Path
) -> None:
    text = ROBOT.replace("modules:", "namespace: rover\nros: {odom_tf: ekf}\nmodules:")
    (tmp_path / "rover.yaml").write_text(text + ALL_SENSORS)
    robot = compile_file(tmp_path / "rover.yaml").model
    assert isinstance(robot, Robot)
    files = {
        path: data.decode().replace(NAME_PREFIX, "rover/")
        for path, data in emit(robot, ["ros2"]).items()
        if "/m" not in path
    }
    wanted: list[tuple[str, str, float]] = []  # topic, type, lowest rate
    for name in ("slam_toolbox", "nav2", "global_costmap_slam", "ekf_odom", "gnss"):
        document = yaml.safe_load(files[f"ros2/config/{name}.yaml"])
        for path, topic in inputs(document):
            if topic in OF_OTHERS:
                continue
            *above, last = path.split(".")
            group: Any = document
            for part in above[1:]:
                group = group[part]
            kind = TYPES[
                group.get("data_type", group.get("type", last)) if last == "topic" else last
            ]
            node = document[above[1]]["ros__parameters"]
            timeout = 1.0 / node.get("source_timeout", math.inf)
            wanted.append((topic, kind, max(timeout, node.get("update_frequency", 0.0))))
    for source, topic in re.findall(
        r'\("(gps/fix|imu)", "([^"]+)"\)', files["ros2/launch/gnss.launch.py"]
    ):
        wanted.append((f"/rover/{topic}", TYPES[source], 0.0))
    assert {topic for topic, _, _ in wanted} == {
        "/rover/lidar/scan",
        "/rover/tower/points",
        "/rover/imu/data",
        "/rover/gnss/fix",
        "/rover/odometry/base_raw",
    }
    with bag[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    published = {
        channel.topic: (summary.schemas[channel.schema_id].name, counts[number] / 2.0)
        for number, channel in summary.channels.items()
    }
    # The odometry of a record has another name than that of the node, which tests/ros reads.
    published["/rover/odometry/base_raw"] = published["/rover/odom"]
    for topic, kind, rate in wanted:
        assert published[topic][0] == kind, topic
        assert published[topic][1] > rate, topic
    links = {
        link.get("name")
        for link in ElementTree.fromstring(files["ros2/urdf/robot.urdf"]).iter("link")
    }
    assert {sensor.frame for sensor in bag[1].sensors.values()} <= links
