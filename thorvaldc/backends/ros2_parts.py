"""The parts of a ROS 2 package that a robot can use, and the reasons for those that are left out.

A part is a launch file with its parameter files. The names of the topics of sensors are those of
``gazebo_topics``: drivers of real sensors are remapped to them.
"""

from __future__ import annotations

from typing import NamedTuple

from thorvaldc.model import Robot, Sensor
from thorvaldc.model.settings import EKF, MAP_FRAME, ODOM_FRAME

SENSOR_TOPICS = {"lidar_2d": "scan", "lidar_3d": "points", "imu": "data", "gnss": "fix"}
"""Last part of the topic of a sensor, by the type of the sensor."""


class Parts(NamedTuple):
    """What the package of a robot contains.

    - ``lidars``: lidars, which detect obstacles.
    - ``slam``: 2d lidar with which slam_toolbox makes a map, or ``None``.
    - ``gnss``: GNSS receiver that localizes the robot, or ``None``.
    - ``imu``: IMU of the EKF, or ``None``.
    - ``left_out``: each part that the package does not contain, and the reason.
    """

    lidars: tuple[Sensor, ...]
    slam: Sensor | None
    gnss: Sensor | None
    imu: Sensor | None
    left_out: tuple[tuple[str, str], ...]

    @property
    def navigation(self) -> bool:
        return bool(self.lidars)

    @property
    def map_sources(self) -> tuple[str, ...]:
        """The localizations that publish the transform from ``map`` to ``odom``; the launch file
        starts the first one by default."""
        sources = (("slam", self.slam), ("gnss", self.gnss))
        return tuple(name for name, sensor in sources if sensor is not None)

    @property
    def localization(self) -> bool:
        """True if the package starts an EKF."""
        return self.gnss is not None or self.local_ekf

    @property
    def local_ekf(self) -> bool:
        """True if an EKF publishes the transform from ``odom`` to ``base_link``."""
        return not any(part == "ekf" for part, _ in self.left_out)


def parts_of(robot: Robot) -> Parts:
    """Return the parts of the package of a robot."""
    lidars = tuple(s for s in robot.sensors if s.type in ("lidar_2d", "lidar_3d"))
    slam = _first(robot, "lidar_2d")
    gnss, imu = _first(robot, "gnss"), _first(robot, "imu")
    left_out = []
    if robot.ros.odom_tf != EKF:
        left_out.append(
            (
                "ekf",
                f"the base driver publishes the transform from `{ODOM_FRAME}` to `base_link`; set "
                "`ros: {odom_tf: ekf}` in the robot file for an EKF of odometry"
                + (" and IMU" if imu is not None else ""),
            )
        )
    if gnss is None:
        left_out.append(("GNSS localization", "the robot has no GNSS receiver"))
    if slam is None:
        left_out.append(("slam_toolbox", "the robot has no 2d lidar"))
    if not lidars:
        left_out.append(("Nav2", "no lidar of the robot detects obstacles"))
    return Parts(lidars, slam, gnss, imu, tuple(left_out))


def _first(robot: Robot, kind: str) -> Sensor | None:
    return next((sensor for sensor in robot.sensors if sensor.type == kind), None)


def node_space(robot: Robot) -> str:
    """Return what stands before the name of a node: ``/r1/``, or ``/`` without a name space."""
    return f"/{robot.prefix}"


def full_topic(robot: Robot, topic: str) -> str:
    """Return a topic of the robot with its name space and the slash at the beginning."""
    return f"/{robot.prefix}{topic}"


def sensor_topic(robot: Robot, sensor: Sensor) -> str:
    """Return the full name of the topic of a sensor, such as ``/r1/lidar/scan``."""
    return full_topic(robot, f"{sensor.name.replace('.', '_')}/{SENSOR_TOPICS[sensor.type]}")


def source_topic(robot: Robot, name: str) -> str:
    """Return the topic of a source of twists, relative to the name space."""
    for source in robot.twist_sources:
        if source.name == name:
            return source.topic
    return f"{name}/cmd_vel"


def odom_frame(robot: Robot) -> str:
    return robot.prefix + ODOM_FRAME


def map_frame(robot: Robot) -> str:
    return robot.prefix + MAP_FRAME


def base_frame(robot: Robot) -> str:
    return robot.prefix + robot.links[0].name
