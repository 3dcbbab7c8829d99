"""A mission in MuJoCo over the topics of the node, and the same without ROS.

``python -m tests.ros.mission MODEL_JSON`` prints the largest distance (m) of the two paths and the
CPU time (ms) of a control cycle with and without ROS.  The twists are deterministic: with the real
time factor 0 the program sends the twist of each cycle with the time of /clock as its stamp, and
runs the cycle when the node has received it.
"""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from thorvaldc.ros.bases import open_robot
from thorvaldc.ros.lifecycle_node import BaseDriverNode
from thorvaldc.ros.node_parameters import load_robot_model
from thorvaldc.runtime.se2 import Twist

CYCLES = 400
SOURCE = "auto_nav"


def twist_at(cycle: int) -> Twist:
    return Twist(0.4 * min(cycle / 50, 1.0), 0.0, 0.3 * math.sin(cycle / 60))


def with_ros(model_file: str) -> tuple[list[tuple[float, float]], float]:
    """Returns the true path of the robot, and the time of a cycle in s."""
    values = {
        "model_file": model_file,
        "base": "mujoco",
        "real_time_factor": 0.0,
        "publish_clock": True,
        "stamped": True,
    }
    rclpy.init()
    node = BaseDriverNode(parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
    client = rclpy.create_node("mission")
    received: dict[str, object] = {}
    client.create_subscription(Clock, "/clock", lambda m: received.update(clock=m.clock), 1)
    client.create_subscription(Odometry, "odometry/base_raw", lambda m: received.update(o=m), 10)
    commands = client.create_publisher(TwistStamped, f"{SOURCE}/cmd_vel", 10)
    node.trigger_configure()
    node.trigger_activate()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(client)
    while commands.get_subscription_count() == 0 or not client.count_publishers("/clock"):
        executor.spin_once(timeout_sec=0.1)
    while "clock" not in received:
        node.run_due()
        executor.spin_once(timeout_sec=0.1)
    robot = node.simulation()
    start = robot.now
    node.robot.call("arm")
    path, elapsed = [], 0.0
    for cycle in range(CYCLES):
        message, twist = TwistStamped(), twist_at(cycle)
        message.header.stamp = received["clock"]
        message.twist.linear.x, message.twist.angular.z = twist.vx, twist.wz
        commands.publish(message)
        while node.inputs.received[SOURCE] <= cycle:
            executor.spin_once(timeout_sec=1.0)
        begin = time.thread_time()
        node.run_due()
        elapsed += time.thread_time() - begin
        while received["clock"].sec + received["clock"].nanosec * 1e-9 < robot.now - 1e-6:
            executor.spin_once(timeout_sec=1.0)
        path.append(robot.driver.base.true_pose()[:2])
    assert node.inputs.refused == {}, node.inputs.refused
    assert abs(robot.now - start - CYCLES * robot.period) < 1e-6
    client.destroy_node()
    node.stop_robot()
    node.destroy_node()
    rclpy.shutdown()
    return [start, *path], elapsed / CYCLES


def without_ros(model_file: str, start: float) -> tuple[list[tuple[float, float]], float]:
    """As ``with_ros``, after the same rest of ``start`` s."""
    robot = open_robot(load_robot_model(model_file), Path(model_file), "mujoco", "", 0.0)
    while robot.now < start - 1e-6:
        robot.run_due_cycle()
    robot.call("arm")
    path, elapsed = [], 0.0
    for cycle in range(CYCLES):
        begin = time.thread_time()
        robot.multiplexer.publish(SOURCE, twist_at(cycle), robot.input_time, "ROS")
        robot.run_due_cycle()
        elapsed += time.thread_time() - begin
        path.append(robot.driver.base.true_pose()[:2])
    return path, elapsed / CYCLES


def main() -> None:
    (start, *path), cycle = with_ros(sys.argv[1])
    reference, bare = without_ros(sys.argv[1], start)
    distance = max(math.dist(a, b) for a, b in zip(path, reference, strict=True))
    length = math.dist(path[0], path[-1])
    result = {"distance": distance, "length": length, "cycle": cycle * 1e3, "bare": bare * 1e3}
    print(json.dumps(result))


if __name__ == "__main__":
    main()
