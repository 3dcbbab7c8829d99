"""The drivers of the sensors of the real robot: nodes, topics, frames, parameters, packages."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from tests.backends.rcl_parameters import read
from tests.backends.ros2.launch_double import Started
from tests.backends.ros2.packages import launch, named, package_of, parameters
from tests.backends.ros2.test_declared_parameters import TABLE, type_of
from tests.examples import FOLDER
from thorvaldc.backends.ros2_parts import sensor_topics
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.model.ros2_driver import Ros2Driver

UNIT = """\
thorvaldc: 1
extends: {design}
name: unit
modules:
  lidar_front: {{params: {{address: 192.168.0.10}}}}
  gnss_main: {{params: {{port: gnss}}}}
  imu: {{params: {{port: /dev/ttyACM0, rate: 200 Hz}}}}
  camera: {{type: sensor/camera, mount: battery_right.lid, params: {{device: /dev/video0}}}}
  gnss_aux: null
computer: {{ports: {{gnss: {{serial: "1"}}}}}}
"""
RAW = Ros2Driver("imus", "imu_node", "frame_id", (("data_raw", "imu/data_raw"),))
PROGRAMS = {
    "urg_node": "urg_node_driver",
    "nmea_navsat_driver": "nmea_serial_driver",
    "microstrain_inertial_driver": "microstrain_inertial_driver_node",
    "usb_cam": "usb_cam_node_exe",
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """A robot whose file states how its computer reaches each sensor of the library."""
    file = tmp_path_factory.mktemp("unit") / "robot.yaml"
    design = FOLDER / "4wd4ws_wide" / "robot.yaml"
    file.write_text(UNIT.format(design=design), encoding="utf-8")
    model = compile_file(file).model
    assert isinstance(model, Robot)
    return dataclasses.replace(model, namespace="r1")


def drivers(robot: Robot, folder: Path, file: str, **arguments: str) -> dict[str, Started]:
    started = launch(robot, folder, file, **arguments).started
    return {f"{node.namespace}/{node.name}": node for node in started if node.respawn_delay}


def sensor_parameters(robot: Robot) -> dict[str, dict[str, Any]]:
    return read(named(robot, "config/sensors.yaml"))


def with_imu(robot: Robot, driver: Ros2Driver, **numbers: float) -> Robot:
    sensors = [
        dataclasses.replace(
            sensor,
            ros2_driver=driver,
            properties=tuple((dict(sensor.properties) | numbers).items()),
        )
        if sensor.type == "imu"
        else sensor
        for sensor in robot.sensors
    ]
    return dataclasses.replace(robot, sensors=tuple(sensors))


def test_the_real_robot_starts_a_driver_for_each_sensor(robot: Robot, tmp_path: Path) -> None:
    """Each is started again when it ends, below the name space of the robot."""
    nodes = drivers(robot, tmp_path, "robot")
    assert {node.package: node.executable for node in nodes.values()} == PROGRAMS
    assert set(nodes) == {f"r1/{sensor.name}/{sensor.name}_node" for sensor in robot.sensors}
    assert all(node.respawn_delay == 2.0 for node in nodes.values())
    assert all(node.on_exit is None for node in nodes.values())
    assert drivers(robot, tmp_path, "robot", sensors="false") == {}
    assert set(drivers(robot, tmp_path, "sensors")) == set(nodes)
    moved = drivers(robot, tmp_path, "robot", namespace="farm/r2")
    assert set(moved) == {f"farm/r2/{sensor.name}/{sensor.name}_node" for sensor in robot.sensors}
    values = read(moved["farm/r2/imu/imu_node"].files[0].read_text(encoding="utf-8"))
    assert values["/farm/r2/imu/imu_node"]["frame_id"] == "farm/r2/imu_imu"


@pytest.mark.parametrize("file", ["ideal", "mujoco", "virtual", "gazebo", "joint_states"])
def test_no_simulation_starts_a_driver(file: str, robot: Robot, tmp_path: Path) -> None:
    assert drivers(robot, tmp_path, file) == {}


def test_a_robot_without_drivers_has_no_file_for_them(robot: Robot) -> None:
    none = tuple(dataclasses.replace(sensor, ros2_driver=None) for sensor in robot.sensors)
    files = package_of(dataclasses.replace(robot, sensors=none))
    assert not any("sensors" in path for path in files)
    assert b"sensors" not in files["launch/robot.launch.py"]


def test_drivers_publish_what_the_other_programs_expect(robot: Robot, tmp_path: Path) -> None:
    """The topics that Nav2, slam_toolbox and the EKFs subscribe to, in frames of the URDF."""
    nodes = drivers(robot, tmp_path, "robot")
    files = parameters(robot)
    description = launch(robot, tmp_path, "ideal").started[0].parameters["robot_description"]
    links = {link.get("name") for link in ElementTree.fromstring(description).iter("link")}
    published = set()
    for sensor in robot.sensors:
        driver = sensor.ros2_driver
        assert driver is not None
        node = nodes[f"r1/{sensor.name}/{sensor.name}_node"]
        assert files[f"/r1/{sensor.name}/{sensor.name}_node"][driver.frame] == f"r1/{sensor.link}"
        assert f"r1/{sensor.link}" in links
        theirs = dict(driver.topics)
        for topic, *_ in sensor_topics(sensor):
            mine = theirs[topic.rpartition("/")[2]]
            published.add(f"/{node.namespace}/{node.remappings.get(mine, mine)}")
            assert f"/{node.namespace}/{node.remappings.get(mine, mine)}" == f"/r1/{topic}"
    assert files["/r1/slam_toolbox"]["scan_topic"] in published
    assert files["/r1/ekf_map"]["imu0"] in published
    text = package_of(robot)["launch/gnss.launch.py"].decode()
    assert '("gps/fix", "gnss_main/fix")' in text
    assert "/r1/gnss_main/fix" in published


def test_the_parameters_of_the_library_are_those_of_the_drivers(robot: Robot) -> None:
    """Each exists in its driver, with the same type; numbers are those of the module."""
    files = sensor_parameters(robot)
    for sensor in robot.sensors:
        assert sensor.ros2_driver is not None
        for name, value in files[f"/r1/{sensor.name}/{sensor.name}_node"].items():
            assert TABLE[sensor.ros2_driver.package][name] == type_of(value), name
    assert files["/r1/gnss_main/gnss_main_node"]["port"] == "/dev/gnss"
    assert files["/r1/imu/imu_node"]["port"] == "/dev/ttyACM0"
    assert files["/r1/imu/imu_node"]["imu_data_rate"] == 200.0
    assert files["/r1/lidar_front/lidar_front_node"]["ip_address"] == "192.168.0.10"


def test_the_package_depends_on_its_drivers_which_are_released(robot: Robot) -> None:
    manifest = ElementTree.fromstring(package_of(with_imu(robot, RAW))["package.xml"])
    depends = {str(element.text) for element in manifest.iter("exec_depend")}
    packages = {"urg_node", "nmea_navsat_driver", "usb_cam", "imu_filter_madgwick"}
    assert packages | {"imus"} <= depends
    lines = Path(__file__).with_name("released_packages.txt").read_text(encoding="utf-8")
    assert {*packages, "microstrain_inertial_driver"} <= set(lines.split())


@pytest.mark.parametrize("has_compass", [False, True])
def test_a_filter_gives_an_imu_its_orientation(
    has_compass: bool, robot: Robot, tmp_path: Path
) -> None:
    topics = (*RAW.topics, *((("mag", "imu/mag"),) if has_compass else ()))
    imu = with_imu(robot, dataclasses.replace(RAW, topics=topics), orientation_accuracy=0.02)
    nodes = drivers(imu, tmp_path, "robot")
    driver, node = nodes["r1/imu/imu_node"], nodes["r1/imu/imu_filter"]
    assert node.package == "imu_filter_madgwick"
    assert driver.remappings["imu/data_raw"] == node.remappings["imu/data_raw"] == "data_raw"
    assert node.remappings["imu/data"] == "data"
    assert ("imu/mag" in node.remappings) is ("imu/mag" in driver.remappings) is has_compass
    values = sensor_parameters(imu)["/r1/imu/imu_filter"]
    assert values["use_mag"] is has_compass
    assert values["publish_tf"] is False
    assert values["orientation_stddev"] == 0.02
    for name, value in values.items():
        assert TABLE["imu_filter_madgwick"][name] == type_of(value)


def test_a_driver_with_an_orientation_needs_no_filter(robot: Robot, tmp_path: Path) -> None:
    assert "r1/imu/imu_filter" not in drivers(robot, tmp_path, "robot")


def test_texts_of_a_module_stay_texts(robot: Robot, tmp_path: Path) -> None:
    """Whatever a module states, launch and rcl read it as it is."""
    odd = '$(var x) "\\ 1e3'
    driver = dataclasses.replace(RAW, parameters=(("text", odd), ("number", "017")))
    node = drivers(with_imu(robot, driver), tmp_path, "robot")["r1/imu/imu_node"]
    values = read(node.files[0].read_text(encoding="utf-8"))["/r1/imu/imu_node"]
    assert values == {"text": odd, "number": "017", "frame_id": "r1/imu_imu"}
