"""The drivers of the sensors of the real robot: their nodes and ROS 2 parameters.

The nodes of a sensor run in a name space of its own below that of the robot, so that topics of two
sensors with the same driver differ. Their names differ too, because diagnostic_updater leaves the
name space out of the names of statuses. Simulations have sensors of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.backends import ros2_parts
from thorvaldc.backends.ros2_parameters import Parameters
from thorvaldc.model import Robot, Sensor
from thorvaldc.model.ros2_driver import RAW_IMU, Ros2Driver, device_path
from thorvaldc.model.sensor_numbers import sensor_numbers

LARGEST_DEVIATION = 1.0
"""Largest value in rad that imu_filter_madgwick accepts as standard deviation."""


class SensorNode(NamedTuple):
    """A node that the robot starts for a sensor.

    - ``space``: name space of the node, below that of the robot.
    - ``remappings``: topics in the program and in ROS; relative ones are in ``space``.
    """

    space: str
    name: str
    package: str
    executable: str
    remappings: list[tuple[str, str]]
    parameters: Parameters

    @property
    def full_name(self) -> str:
        """Name of the node below the name space of the robot."""
        return f"{self.space}/{self.name}"


def sensor_nodes(robot: Robot) -> Iterator[SensorNode]:
    """Yield the drivers of the sensors of a robot, and the filters of IMUs whose drivers give no
    orientation."""
    for sensor in robot.sensors:
        if sensor.ros2_driver is not None:
            yield _driver(robot, sensor, sensor.ros2_driver)
            topics = dict(sensor.ros2_driver.topics)
            if RAW_IMU[0] in topics and "data" not in topics:
                yield _filter(sensor, has_compass=RAW_IMU[1] in topics)


def _driver(robot: Robot, sensor: Sensor, driver: Ros2Driver) -> SensorNode:
    parameters: Parameters = {
        **dict(driver.parameters),
        **{name: device_path(port) for name, port in driver.ports},
        driver.frame: f"{robot.prefix}{sensor.link}",
    }
    remappings = [(theirs, ours) for ours, theirs in driver.topics if ours != theirs]
    space = ros2_parts.sensor_space(sensor)
    name = ros2_parts.sensor_node(sensor)
    return SensorNode(space, name, driver.package, driver.executable, remappings, parameters)


def _filter(sensor: Sensor, *, has_compass: bool) -> SensorNode:
    """Return the filter that gives the orientation of an IMU.

    Without a magnetometer, the yaw is relative to that at the start. Parameters and topics are
    those of imu_filter_madgwick/src/imu_filter_ros.cpp of CCNYRoboticsLab/imu_tools, branch
    rolling, c8a27cd.
    """
    deviation = sensor_numbers(sensor)["orientation_accuracy"]
    parameters: Parameters = {
        "use_mag": has_compass,
        "publish_tf": False,
        "world_frame": "enu",
        "orientation_stddev": min(deviation, LARGEST_DEVIATION),
    }
    topics = ("data", *RAW_IMU) if has_compass else ("data", RAW_IMU[0])
    return SensorNode(
        ros2_parts.sensor_space(sensor),
        f"{ros2_parts.sensor_space(sensor)}_filter",
        "imu_filter_madgwick",
        "imu_filter_madgwick_node",
        [(f"imu/{topic}", topic) for topic in topics],
        parameters,
    )
