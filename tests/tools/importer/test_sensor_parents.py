"""Sensors of original files: parent links, types of lidars, and parameters with dots."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.tools.importer.test_importer import compiled, convert_text, find, poses
from thorvaldc.model import Pose, Robot

DRIVES = """
motor_drives:
  drive0: {node: 1, x: -0.549, y: -0.449, type: 0}
  drive1: {node: 2, x: 0.549, y: -0.449, type: 0}
  drive2: {node: 3, x: 0.549, y: 0.449, type: 0}
  drive3: {node: 4, x: -0.549, y: 0.449, type: 0}
corners:
  corner1: {type: 1, x: 0.425, y: -0.445, z: 0.65}
  corner2: {type: 2, x: 0.425, y: 0.445, z: 0.65}
"""


def sensor_pose(robot: Robot, name: str) -> Pose:
    (sensor,) = [s for s in robot.sensors if s.module == name]
    return poses(robot)[sensor.link]


@pytest.mark.parametrize(
    ("parent", "place", "yaw", "carrier"),
    [
        ("base_link", (0.0, 0.0, 0.0), 0.0, "frame"),
        ("/robot/base_link", (0.0, 0.0, 0.0), 0.0, "frame"),
        ("corner2", (0.425, 0.445, 0.65), math.pi, "corner2"),
        ("corner2_2", (0.425, 0.445, 0.65), math.pi, "corner2"),
        ("corner1_1", (0.425, -0.445, 0.65), math.pi / 2, "corner1"),
        ("top1", (0.549, -0.449, 0.65), 0.0, "frame"),
    ],
)
@pytest.mark.parametrize("key", ["lidar", "gnss_antenna", "imu", "camera"])
def test_the_pose_of_a_sensor_is_relative_to_its_parent_link(
    tmp_path: Path,
    parent: str,
    place: tuple[float, float, float],
    yaw: float,
    carrier: str,
    key: str,
) -> None:
    entry = f"{key}: {{parent_link: {parent}, x: 0.05, y: 0.02, z: 0.1, yaw: 0.5}}\n"
    result, report = convert_text(tmp_path, DRIVES + entry)
    robot = compiled(tmp_path, result.text)
    expected = Pose.from_xyz_rpy(place, (0.0, 0.0, yaw)) * Pose.from_xyz_rpy(
        (0.05, 0.02, 0.1), (0.0, 0.0, 0.5)
    )
    link_poses = poses(robot)
    pose = link_poses[f"{key}_body"] if key == "camera" else sensor_pose(robot, key)
    assert pose.xyz == pytest.approx(expected.xyz, abs=1e-9)
    assert pose.rotate((1.0, 0.0, 0.0)) == pytest.approx(expected.rotate((1.0, 0.0, 0.0)))
    assert result.text is not None
    assert f"{{parent: {carrier}, xyz:" in result.text.split(f"# {key}")[1]
    if not parent.endswith("base_link"):
        assumed = find(report, "import-assumed", key, f"`{parent}`", "is assumed")
        assert assumed.span is not None
        assert assumed.span.line == 10


def test_an_unknown_parent_link_is_base_link(tmp_path: Path) -> None:
    entry = "lidar: {parent_link: top7, x: 0, y: 0, z: 0.8}\n"
    result, report = convert_text(tmp_path, DRIVES + entry)
    assert sensor_pose(compiled(tmp_path, result.text), "lidar").xyz == pytest.approx((0, 0, 0.8))
    find(report, "import-assumed", "`top7`", "base_link is assumed")


@pytest.mark.parametrize(
    ("text", "expected"),
    [("2d", "lidar_2d"), ('"3d"', "lidar_3d"), ("3D", "lidar_3d"), ("4d", "lidar_2d")],
)
def test_the_type_of_a_lidar_chooses_its_module(tmp_path: Path, text: str, expected: str) -> None:
    entry = f"lidar_top: {{type: {text}, parent_link: base_link, x: 0, y: 0, z: 1.2}}\n"
    result, report = convert_text(tmp_path, DRIVES + entry)
    robot = compiled(tmp_path, result.text)
    assert [sensor.type for sensor in robot.sensors] == [expected]
    assert sensor_pose(robot, "lidar_top").xyz == pytest.approx((0.0, 0.0, 1.2))
    if text == "4d":
        find(report, "import-assumed", "`4d`")


def test_parameters_of_ros_2_with_dots(tmp_path: Path) -> None:
    nested, _ = convert_text(tmp_path, DRIVES)
    dotted = """
/thorvald/base_driver:
  ros__parameters:
    motor_drives.drive0: {node: 1, x: -0.549, y: -0.449, type: 0}
    motor_drives.drive1.node: 2
    motor_drives.drive1.x: 0.549
    motor_drives:
      drive1: {y: -0.449}
      drive1.type: 0
      drive2: {node: 3, x: 0.549, y: 0.449, type: 0}
      drive3: {node: 4, x: -0.549, y: 0.449, type: 0}
    corners.corner1: {type: 1, x: 0.425, y: -0.445, z: 0.65}
    corners.corner2: {type: 2, x: 0.425, y: 0.445, z: 0.65}
"""
    result, report = convert_text(tmp_path, dotted)
    assert [d.code.name for d in report if d.code.name == "import-unknown-key"] == []

    def wheels(text: str | None) -> list[tuple[str, float, float]]:
        return sorted((w.name, w.x, w.y) for w in compiled(tmp_path, text).wheels)

    assert wheels(result.text) == wheels(nested.text)


def test_a_key_that_is_written_twice_in_two_ways(tmp_path: Path) -> None:
    text = DRIVES.replace("corners:", "motor_drives.drive0.x: -0.5\ncorners:")
    result, report = convert_text(tmp_path, text)
    find(report, "import-duplicate-key", "`x`")
    robot = compiled(tmp_path, result.text)
    assert min(wheel.x for wheel in robot.wheels) == pytest.approx(-0.549)
    assert {round(wheel.x, 3) for wheel in robot.wheels} == {0.549, -0.5, -0.549}
