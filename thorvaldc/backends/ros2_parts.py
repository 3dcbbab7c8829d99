"""The parts of a ROS 2 package that a robot can use, the reasons for those that are left out, and
the names of topics and frames in ROS 2 and Gazebo.

A part is a launch file with its parameter files. Drivers of real sensors are remapped to the topics
that sensors have in Gazebo.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from thorvaldc.backends.sdf_extra_sensors import extra_sensors
from thorvaldc.model import Robot, Sensor, joint_topics
from thorvaldc.model.joint_topics import topic_of
from thorvaldc.model.settings import EKF, MAP_FRAME, ODOM_FRAME
from thorvaldc.model.statics.standing import stands_without_couplings

CLOCK, JOINT_STATES, TRUE_ODOMETRY = "clock", "joint_states", "odometry/true"
"""Topics in Gazebo."""
GAZEBO_CLOCK = "gazebo_clock"
"""Topic in ROS with the time of every step of Gazebo's physics; see ``CLOCK_TOPIC``."""

SENSOR_TOPICS = {
    "lidar_2d": (("scan", "sensor_msgs/msg/LaserScan", "gz.msgs.LaserScan"),),
    "lidar_3d": (("points", "sensor_msgs/msg/PointCloud2", "gz.msgs.PointCloudPacked"),),
    "imu": (("data", "sensor_msgs/msg/Imu", "gz.msgs.IMU"),),
    "gnss": (("fix", "sensor_msgs/msg/NavSatFix", "gz.msgs.NavSat"),),
    "camera": (
        ("image_raw", "sensor_msgs/msg/Image", "gz.msgs.Image"),
        ("camera_info", "sensor_msgs/msg/CameraInfo", "gz.msgs.CameraInfo"),
    ),
}
"""Topics of a sensor below its name, with the type in ROS and in Gazebo, by the sensor's type."""
_EXTRA_KINDS = {
    "gpu_lidar": "lidar_2d",
    "points": "lidar_3d",
    "imu": "imu",
    "navsat": "gnss",
    "camera": "camera",
}
"""Type of the model for the types of SDF of sensors of extras; the bridge knows their messages."""
_ROS_NAME = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


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
        sources = (("slam", self.slam), ("gnss", self.gnss), ("amcl", self.slam))
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
    if not stands_without_couplings(robot):
        left_out.append(("couplings in Gazebo", "SDF has none: the robot does not stand there"))
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
    """Return the full name of the first topic of a sensor, such as ``/r1/lidar/scan``."""
    return full_topic(robot, sensor_topics(sensor)[0][0])


def source_topic(robot: Robot, name: str) -> str:
    """Return the topic of a source of twists, relative to the name space."""
    for source in robot.twist_sources:
        if source.name == name:
            return source.topic
    return f"{name}/cmd_vel"


WORLD_FRAME = "world"
"""Frame of the true poses of Gazebo: its ``OdometryPublisher`` sends poses in the world, whatever
frame it is told to write into the messages."""


def odom_frame(robot: Robot) -> str:
    return robot.prefix + ODOM_FRAME


def map_frame(robot: Robot) -> str:
    return robot.prefix + MAP_FRAME


def base_frame(robot: Robot) -> str:
    return robot.prefix + robot.links[0].name


# -- Gazebo ----------------------------------------------------------------------------
#
# A topic in Gazebo begins with the name space of the robot. The bridge to ROS 2 runs in this name
# space, so that its ROS topics are relative.


class BridgedTopic(NamedTuple):
    """A topic that the bridge connects.

    - ``ros``, ``gazebo``: names of the topic; the name in ROS is relative to the name space.
    - ``ros_type``, ``gazebo_type``: types of the messages.
    - ``to_gazebo``: true for commands.
    """

    ros: str
    gazebo: str
    ros_type: str
    gazebo_type: str
    to_gazebo: bool = False


# Gazebo sends the time at every step of the physics, and neither Gazebo nor the bridge can send it
# less often.  Each message wakes every node that takes its time from ``/clock``, and costs a node
# in Python 0.7 ms.  So a node in ``gazebo.launch.py`` passes on only one of ten messages.
CLOCK_TOPIC = BridgedTopic(GAZEBO_CLOCK, f"/{CLOCK}", "rosgraph_msgs/msg/Clock", "gz.msgs.Clock")


def sensor_space(sensor: Sensor) -> str:
    """Return the name space of the topics of a sensor, relative to that of the robot."""
    return topic_of(sensor.name)


def sensor_node(sensor: Sensor) -> str:
    """Return the name of the node that is the driver of a sensor."""
    return f"{sensor_space(sensor)}_node"


def sensor_topics(sensor: Sensor) -> list[tuple[str, str, str]]:
    """Return the topics of a sensor relative to the name space of the robot, each with its type in
    ROS and in Gazebo; an empty list for a sensor that Gazebo does not simulate."""
    return [
        (f"{sensor_space(sensor)}/{name}", ros_type, gazebo_type)
        for name, ros_type, gazebo_type in SENSOR_TOPICS.get(sensor.type, ())
    ]


def bridged_topics(robot: Robot, *, ros2_control: bool = False) -> list[BridgedTopic]:
    """Return the topics of a robot in Gazebo that the bridge connects.

    With ``ros2_control``, its controllers have the joints: the bridge passes on neither joint
    states nor commands.
    """
    prefix = robot.prefix
    topics = []
    if not ros2_control:
        states = ("sensor_msgs/msg/JointState", "gz.msgs.Model")
        topics.append(BridgedTopic(joint_topics.JOINT_STATES, prefix + JOINT_STATES, *states))
        for _, topic in joint_topics.command_topics(robot):
            number = ("std_msgs/msg/Float64", "gz.msgs.Double")
            topics.append(BridgedTopic(topic, prefix + topic, *number, to_gazebo=True))
    odometry = ("nav_msgs/msg/Odometry", "gz.msgs.Odometry")
    topics.append(BridgedTopic(TRUE_ODOMETRY, prefix + TRUE_ODOMETRY, *odometry))
    for sensor in robot.sensors:
        for topic, ros_type, gazebo_type in sensor_topics(sensor):
            topics.append(BridgedTopic(topic, prefix + topic, ros_type, gazebo_type))
    for extra in extra_sensors(robot):
        kind = _EXTRA_KINDS.get("points" if extra.has_points else extra.type)
        topic = extra.topic_of(prefix) + ("/points" if extra.has_points else "")
        in_ros = topic.removeprefix(prefix).strip("/")
        if kind is not None and _ROS_NAME.fullmatch(in_ros):
            _, ros_type, gazebo_type = SENSOR_TOPICS[kind][0]
            topics.append(BridgedTopic(in_ros, topic, ros_type, gazebo_type))
    return topics
