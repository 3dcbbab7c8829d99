"""Names of the ROS topics through which joints in another program are commanded and measured.

The generated files connect these topics to a simulation, and the base driver uses them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from thorvaldc.model.robot import Robot

JOINT_STATES = "engine/joint_states"
"""Joint states of a simulation, relative to the name space of the robot.  The topic
``joint_states`` is that of the base driver."""
SPEEDS, ANGLES = "engine/joint_speeds", "engine/joint_angles"
"""Commands as messages of the type JointState."""
HEARTBEAT = "engine/heartbeat"
"""Sign of life of the base driver in each control cycle, for its guard."""
BROADCASTER = "joint_state_broadcaster"
SPEED_CONTROLLER, ANGLE_CONTROLLER = "drive_velocity_controller", "steering_position_controller"
"""Controllers of ros2_control that pass on speeds and angles."""
_COMMANDS = {"velocity": "cmd_vel", "position": "cmd_pos"}
_NO_TOPIC = re.compile(r"[^A-Za-z0-9_]")


def topic_of(name: str) -> str:
    """Returns a name as a topic of ROS.

    Each character that ROS does not allow becomes an underscore.  A part that begins with a digit
    gets an underscore in front.
    """
    parts = [_NO_TOPIC.sub("_", part) for part in name.split("/") if part]
    return "/".join(f"_{part}" if part[0].isdigit() else part for part in parts)


def command_topic(joint: str, interface: str) -> str:
    """Returns the topic of the commands of one joint, relative to the name space of the robot.

    ``interface``: ``velocity`` or ``position``.
    """
    return topic_of(f"{joint}/{_COMMANDS[interface]}")


def command_topics(robot: Robot) -> Iterator[tuple[str, str]]:
    """Yields each driven joint and the topic of its commands, those of extras too."""
    for actuator in robot.actuators:
        interface = "velocity" if actuator.role == "propulsion" else "position"
        yield actuator.joint, command_topic(actuator.joint, interface)
    for servo in robot.joint_servos:
        yield servo.joint, command_topic(servo.joint, servo.interface)
