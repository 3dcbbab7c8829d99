"""Sends constant commands for each joint state of an engine, and prints what the joints do.

``joint_commands.py FORM SPACE SECONDS SPEEDS ANGLES``: FORM is "controllers" or "joint_states";
SECONDS of the stamps; SPEEDS (rad/s) and ANGLES (rad) are JSON objects by joint, in the order of
the messages.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

TIMEOUT = 120.0  # s, real time


def seconds(message: Any) -> float:
    return float(message.header.stamp.sec) + 1e-9 * float(message.header.stamp.nanosec)


class Commander:
    """Answers each joint state with commands."""

    def __init__(self, form: str, space: str, speeds: dict[str, float], angles: Any) -> None:
        self.node = rclpy.create_node("commander", namespace=space)
        self.states: list[JointState] = []
        self.truth: list[Odometry] = []
        self.is_ros2_control = form == "controllers"
        self.commands = {"speed": speeds, "angle": angles}
        kind: Any = Float64MultiArray if self.is_ros2_control else JointState
        names = {"speed": "drive_velocity_controller", "angle": "steering_position_controller"}
        self.publishers = {
            key: self.node.create_publisher(
                kind, f"{name}/commands" if self.is_ros2_control else key, 10
            )
            for key, name in names.items()
        }
        states = "joint_state_broadcaster/joint_states" if self.is_ros2_control else "states"
        self.node.create_subscription(JointState, states, self.answer, 10)
        self.node.create_subscription(Odometry, "odometry/true", self.truth.append, 10)

    def answer(self, message: JointState) -> None:
        self.states.append(message)
        for key, values in self.commands.items():
            numbers = [float(value) for value in values.values()]
            if self.is_ros2_control:
                self.publishers[key].publish(Float64MultiArray(data=numbers))
            else:
                array = {"velocity" if key == "speed" else "position": numbers}
                self.publishers[key].publish(JointState(name=list(values), **array))

    def is_heard(self) -> bool:
        return all(p.get_subscription_count() for p in self.publishers.values())

    def has_all_until(self, time: float) -> bool:
        """Returns whether the messages of all topics have come: one can be later than another."""
        newest = [messages[-1] for messages in (self.states, self.truth) if messages]
        return all(seconds(message) > time for message in newest)


def main(form: str, space: str, duration: str, speeds: str, angles: str) -> None:
    rclpy.init()
    commander = Commander(form, space, json.loads(speeds), json.loads(angles))
    timeout, end = time.monotonic() + TIMEOUT, None
    while end is None or not commander.has_all_until(end):
        if time.monotonic() > timeout:
            raise SystemExit("joint states come no longer, or never came")
        rclpy.spin_once(commander.node, timeout_sec=0.1)
        if end is None and commander.is_heard() and commander.states:
            end = seconds(commander.states[-1]) + float(duration)
    last = commander.states[-1]
    print(
        json.dumps(
            {
                "names": list(last.name),
                "position": dict(zip(last.name, last.position, strict=True)),
                "velocity": dict(zip(last.name, last.velocity, strict=True)),
                "x": commander.truth[-1].pose.pose.position.x if commander.truth else 0.0,
            }
        )
    )
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
