"""Sensors in the SDF: values of the robot file, and defaults for those that it leaves out."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import pytest

from tests.backend_files import files_of
from tests.robots import FOUR_STEERED, SPAN, make_robot
from thorvaldc.backends.sdf import Sdf
from thorvaldc.model import Scalar, Sensor


def sensor(kind: str, **properties: Scalar) -> ElementTree.Element | None:
    """Returns the element of a sensor on the first link of a robot."""
    robot = make_robot(FOUR_STEERED)
    added = Sensor("eye", "eye", kind, robot.links[0].name, tuple(properties.items()), SPAN)
    files = files_of(Sdf, replace(robot, sensors=(added,)))
    for content in files.values():
        if b"<sensor" in content:
            return next(ElementTree.fromstring(content).iter("sensor"))
    return None


def values(element: ElementTree.Element | None, path: str) -> list[float]:
    assert element is not None
    found = element.find(path)
    assert found is not None, path
    return [float(child.text or "nan") for child in found if len(child) == 0]


def test_default_lidar() -> None:
    element = sensor("lidar_2d")
    assert element is not None
    assert element.get("type") == "gpu_lidar"
    assert element.findtext("update_rate") == "10"
    assert values(element, "lidar/scan/horizontal") == pytest.approx([361, -math.pi, math.pi])
    assert element.find("lidar/scan/vertical") is None
    assert values(element, "lidar/range") == [0.05, 30.0]


def test_lidar_with_layers() -> None:
    element = sensor(
        "lidar_3d",
        rate=20.0,
        field_of_view=2.0,
        angular_resolution=0.01,
        vertical_field_of_view=0.5,
        layers=32,
        minimum_range=0.4,
        range=100.0,
    )
    assert element is not None
    assert element.findtext("update_rate") == "20"
    assert values(element, "lidar/scan/horizontal") == [201.0, -1.0, 1.0]
    assert values(element, "lidar/scan/vertical") == [32.0, -0.25, 0.25]
    assert values(element, "lidar/range") == [0.4, 100.0]
    default = sensor("lidar_3d")
    expected = [16.0, -math.radians(15.0), math.radians(15.0)]
    assert values(default, "lidar/scan/vertical") == pytest.approx(expected)
    narrow = sensor("lidar_2d", field_of_view=0.001)
    assert values(narrow, "lidar/scan/horizontal")[0] == 2.0


def test_camera() -> None:
    element = sensor("camera")
    assert values(element, "camera/image") == [1280.0, 720.0]
    assert values(element, "camera/clip") == [0.05, 100.0]
    assert element is not None
    assert float(element.findtext("camera/horizontal_fov") or 0) == pytest.approx(
        math.radians(69.0)
    )
    element = sensor("camera", horizontal_field_of_view=1.25, image_width=640, image_height=480)
    assert element is not None
    assert element.findtext("camera/horizontal_fov") == "1.25"
    assert values(element, "camera/image") == [640.0, 480.0]


def test_noise_of_an_imu_grows_with_its_rate() -> None:
    element = sensor("imu", rate=400.0, gyro_noise=0.001, accelerometer_noise=0.01)
    for axis in "xyz":
        assert values(element, f"imu/angular_velocity/{axis}/noise") == [0.0, 0.02]
        assert values(element, f"imu/linear_acceleration/{axis}/noise") == [0.0, 0.2]
    element = sensor("imu", gyro_noise=0.001)
    assert values(element, "imu/angular_velocity/x/noise") == [0.0, 0.01]
    assert element is not None
    assert element.find("imu/linear_acceleration") is None


def test_accuracy_of_a_receiver() -> None:
    element = sensor("gnss", accuracy=0.02)
    for axis in ("horizontal", "vertical"):
        assert values(element, f"navsat/position_sensing/{axis}/noise") == [0.0, 0.02]
    element = sensor("gnss")
    assert element is not None
    assert element.find("navsat") is None


def test_a_sensor_without_counterpart_is_left_out() -> None:
    assert sensor("radar") is None
