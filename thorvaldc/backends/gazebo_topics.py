"""Topics of a robot in Gazebo, and the file with which ros_gz_bridge connects them to ROS 2.

A topic in Gazebo begins with the name space of the robot. The bridge runs in this name space, so
that its ROS topics are relative.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from thorvaldc.backends.ros2_parameter_file import HEADER, quoted
from thorvaldc.model import Robot, Sensor

CLOCK, JOINT_STATES, TRUE_ODOMETRY = "clock", "joint_states", "odometry/true"
GAZEBO_CLOCK = "gazebo_clock"
"""Topic in ROS with the time of every step of Gazebo's physics; see ``gz_bridge``."""
VELOCITY_COMMAND, POSITION_COMMAND = "cmd_vel", "cmd_pos"

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
_NO_TOPIC = re.compile(r"[^A-Za-z0-9_]")


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


def sensor_topics(sensor: Sensor) -> list[tuple[str, str, str]]:
    """Return the topics of a sensor relative to the name space of the robot, each with its type in
    ROS and in Gazebo; an empty list for a sensor that Gazebo does not simulate."""
    return [
        (topic_of(f"{sensor.name}/{name}"), ros_type, gazebo_type)
        for name, ros_type, gazebo_type in SENSOR_TOPICS.get(sensor.type, ())
    ]


def topic_of(name: str) -> str:
    """Return a name as a topic of ROS.

    Each character that ROS does not allow becomes an underscore. A part that begins with a digit
    gets an underscore in front.
    """
    parts = [_NO_TOPIC.sub("_", part) for part in name.split("/") if part]
    return "/".join(f"_{part}" if part[0].isdigit() else part for part in parts)


def joint_commands(robot: Robot) -> Iterator[tuple[str, str]]:
    """Yield each driven joint and the topic of its command relative to the name space."""
    for actuator in robot.actuators:
        command = VELOCITY_COMMAND if actuator.role == "propulsion" else POSITION_COMMAND
        yield actuator.joint, topic_of(f"{actuator.joint}/{command}")
    for servo in robot.joint_servos:
        command = VELOCITY_COMMAND if servo.interface == "velocity" else POSITION_COMMAND
        yield servo.joint, topic_of(f"{servo.joint}/{command}")


def bridged_topics(robot: Robot, *, ros2_control: bool = False) -> list[BridgedTopic]:
    """Return the topics of a robot in Gazebo that the bridge connects.

    With ``ros2_control``, its controllers have the joints: the bridge passes on neither joint
    states nor commands.
    """
    prefix = robot.prefix
    topics = []
    if not ros2_control:
        state = BridgedTopic(
            JOINT_STATES, prefix + JOINT_STATES, "sensor_msgs/msg/JointState", "gz.msgs.Model"
        )
        topics.append(state)
        for _, topic in joint_commands(robot):
            number = ("std_msgs/msg/Float64", "gz.msgs.Double")
            topics.append(BridgedTopic(topic, prefix + topic, *number, to_gazebo=True))
    odometry = ("nav_msgs/msg/Odometry", "gz.msgs.Odometry")
    topics.append(BridgedTopic(TRUE_ODOMETRY, prefix + TRUE_ODOMETRY, *odometry))
    for sensor in robot.sensors:
        for topic, ros_type, gazebo_type in sensor_topics(sensor):
            topics.append(BridgedTopic(topic, prefix + topic, ros_type, gazebo_type))
    return topics


def gz_bridge(robot: Robot, *, ros2_control: bool = False, clock: bool = True) -> str:
    """Return the text of the YAML file ``config_file`` of the node ros_gz_bridge.

    ``clock`` adds the topic ``/clock`` of Gazebo, as ``GAZEBO_CLOCK`` in ROS: Gazebo sends it at
    every step of the physics, and neither Gazebo nor the bridge can send it less often. Each
    message wakes every node that takes its time from ``/clock``, and costs a node in Python 0.7 ms.
    So a node in ``gazebo.launch.py`` passes on only one of ten messages. Only one bridge of a fleet
    may have the clock. See ``bridged_topics`` for ``ros2_control``.
    """
    topics: Sequence[BridgedTopic] = bridged_topics(robot, ros2_control=ros2_control)
    if clock:
        types = ("rosgraph_msgs/msg/Clock", "gz.msgs.Clock")
        topics = [BridgedTopic(GAZEBO_CLOCK, f"/{CLOCK}", *types), *topics]
    lines = [HEADER]
    for topic in topics:
        lines.append(f"- ros_topic_name: {quoted(topic.ros)}\n")
        lines.append(f"  gz_topic_name: {quoted(topic.gazebo)}\n")
        lines.append(f"  ros_type_name: {quoted(topic.ros_type)}\n")
        lines.append(f"  gz_type_name: {quoted(topic.gazebo_type)}\n")
        direction = "ROS_TO_GZ" if topic.to_gazebo else "GZ_TO_ROS"
        lines.append(f"  direction: {direction}\n")
    return "".join(lines)
