"""Joint states and joint commands of a robot as ROS messages, in the dialect of the other program.

============ ================================================ ==================================
dialect      commands                                         joint states
============ ================================================ ==================================
gazebo       ``JOINT/cmd_vel``, ``JOINT/cmd_pos`` (Float64)   ``engine/joint_states``
ros2_control ``CONTROLLER/commands`` (Float64MultiArray)      those of joint_state_broadcaster
joint_states ``engine/joint_speeds``, ``engine/joint_angles`` ``engine/joint_states``
             (JointState)
============ ================================================ ==================================

All topics are relative to the name space of the robot.  Speeds are in rad/s, angles in rad.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from thorvaldc.model import Robot, wheel_joints
from thorvaldc.model import joint_topics as names
from thorvaldc.ros.parameters import GAZEBO, JOINT_STATES, ROS2_CONTROL
from thorvaldc.runtime.base_interface import JointCommands, JointStates

STATES_TOPICS = {
    GAZEBO: names.JOINT_STATES,
    ROS2_CONTROL: f"{names.BROADCASTER}/joint_states",
    JOINT_STATES: names.JOINT_STATES,
}
"""Topic of the joint states in each dialect."""
_DELIVERY = 0.1
"""Longest real time (s) for which the end waits for each subscriber of commands."""


class JointStateReader:
    """Reads the joint states of one robot from messages that may contain more joints.

    - ``others``: position (rad or m) and speed of each other joint of the robot, such as those of
      suspensions and extras, as far as they are finite.
    """

    def __init__(self, robot: Robot, *, wrapped: bool) -> None:
        """``wrapped``: angles and positions may be given modulo 2 pi."""
        self._robot = robot
        self._wrapped = wrapped
        speeds, angles = wheel_joints(robot)
        self._wheels: dict[str, tuple[list[int], bool]] = {}
        """Wheels on each joint, and whether it steers them: two wheels may share a joint."""
        for joint in (*speeds, *angles):
            wheels = [
                i
                for i, wheel in enumerate(robot.wheels)
                if joint in (wheel.spin_joint, wheel.steering_joint)
            ]
            self._wheels[robot.prefix + joint] = (wheels, joint in angles)
        full_names = {robot.prefix + joint.name: joint.name for joint in robot.joints}
        self._others = {full: n for full, n in full_names.items() if full not in self._wheels}
        self._known: list[str] = []
        self._places: list[tuple[int, list[int], bool]] = []
        self._other_places: list[tuple[int, str]] = []
        self._turned: dict[str, float] = {}
        self.others: dict[str, tuple[float, float]] = {}

    def read(self, message: Any, now: float) -> JointStates:
        """Returns the joint states of a message at ``now`` (s).

        Raises ``ValueError`` with the reason if the message has no usable state of each joint.
        """
        if message.name != self._known:
            self._find(message.name)
        count, positions, velocities = len(message.name), message.position, message.velocity
        for what, numbers in (("position", positions), ("velocity", velocities)):
            if len(numbers) != count:
                raise ValueError(f"`{what}` has {len(numbers)} numbers for {count} joints")
        wheels = len(self._robot.wheels)
        speeds, turned = [0.0] * wheels, [0.0] * wheels
        angles, rates = [0.0] * wheels, [0.0] * wheels
        for k, on_joint, is_steering in self._places:
            position, velocity = positions[k], velocities[k]
            if not math.isfinite(position + velocity):
                raise ValueError(
                    f"the joint {self._known[k]} has the position {position:g} and the speed"
                    f" {velocity:g}"
                )
            if self._wrapped:
                position = self._unwrapped(self._known[k], position)
            for i in on_joint:
                if is_steering:
                    angles[i], rates[i] = position, velocity
                else:
                    turned[i], speeds[i] = position, velocity
        self.others = {
            name: (positions[k], velocities[k])
            for k, name in self._other_places
            if math.isfinite(positions[k] + velocities[k])
        }
        return JointStates(now, speeds, angles, rates, turned)

    def _find(self, joints: Sequence[str]) -> None:
        self._known = []
        missing = [joint for joint in self._wheels if joint not in joints]
        if len(missing) == len(self._wheels):
            first = ", ".join(joints[:3]) or "none"
            raise ValueError(f"no joint is one of {self._robot.name}; the joints are: {first}")
        if missing:
            raise ValueError(f"the state of {', '.join(missing)} is missing")
        self._places = [(k, *self._wheels[n]) for k, n in enumerate(joints) if n in self._wheels]
        self._other_places = [
            (k, self._others[n]) for k, n in enumerate(joints) if n in self._others
        ]
        self._known = list(joints)

    def _unwrapped(self, joint: str, position: float) -> float:
        last = self._turned.get(joint, position)
        self._turned[joint] = last + math.remainder(position - last, math.tau)
        return self._turned[joint]


# -- commands ------------------------------------------------------------------------------------


class JointCommandTopics:
    """Publishes the commands of the wheels' joints."""

    def __init__(self, node: Any, robot: Robot, dialect: str) -> None:
        """Creates the publishers on ``node``, in its name space."""
        self._node = node
        self._dialect = dialect
        self._prefix = robot.prefix
        self.publishers: list[Any] = []
        speeds, angles = wheel_joints(robot)
        self._speed_wheels, self._angle_wheels = list(speeds.values()), list(angles.values())
        self._send_speeds = self._sender("velocity", speeds, names.SPEED_CONTROLLER, names.SPEEDS)
        self._send_angles = self._sender("position", angles, names.ANGLE_CONTROLLER, names.ANGLES)

    def send(self, commands: JointCommands) -> None:
        """Publishes the command of each joint."""
        self._send_speeds([float(commands.speeds[i]) for i in self._speed_wheels])
        self._send_angles([float(commands.angles[i]) for i in self._angle_wheels])

    def stop(self) -> None:
        """Publishes the speed 0 for all drives; the steering joints keep their angles."""
        self._send_speeds([0.0] * len(self._speed_wheels))

    def _sender(
        self, interface: str, joints: Mapping[str, int], controller: str, topic: str
    ) -> Callable[[list[float]], None]:
        """Returns the function that publishes one number for each of ``joints``."""
        if not joints:
            return lambda numbers: None
        if self._dialect == GAZEBO:
            topics = [names.command_topic(joint, interface) for joint in joints]
            singles = [self._publisher(Float64, topic) for topic in topics]

            def send_singles(numbers: list[float]) -> None:
                for publisher, number in zip(singles, numbers, strict=True):
                    publisher.publish(Float64(data=number))

            return send_singles
        if self._dialect == ROS2_CONTROL:
            array = self._publisher(Float64MultiArray, f"{controller}/commands")
            return lambda numbers: array.publish(Float64MultiArray(data=numbers))
        states = self._publisher(JointState, topic)
        full_names = [self._prefix + joint for joint in joints]

        def send_states(numbers: list[float]) -> None:
            message = JointState(name=full_names, **{interface: numbers})
            message.header.stamp = self._node.get_clock().now().to_msg()
            states.publish(message)

        return send_states

    def _publisher(self, kind: Any, topic: str) -> Any:
        self.publishers.append(self._node.create_publisher(kind, topic, 1))
        return self.publishers[-1]

    def close(self) -> None:
        """Stops the drives, because the other program keeps the last commands, and removes the
        publishers when it has them."""
        self.stop()
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=_DELIVERY))
            self._node.destroy_publisher(publisher)
