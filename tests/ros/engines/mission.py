"""Drives robots in an engine over the topics of their base drivers, and compares their odometry.

``python -m tests.ros.engines.mission SECONDS NAMESPACE[,NAMESPACE ...]`` prints for each robot the
true path (m), and the error of the odometry at the end: distance (m) and yaw (rad).  The time is
that of the engine.  An empty name space is written as ``-``.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import sys
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

TIMEOUT = 120.0  # s, real time without progress
REST = 3.0
"""Time (s) at the end in which zero is commanded."""
Pose = tuple[float, float, float]


def twist_at(now: float, seconds: float) -> tuple[float, float]:
    """Returns the speed (m/s) and the yaw rate (rad/s) of the mission: curves to both sides."""
    if now < 0.5 or now > seconds - REST:
        return 0.0, 0.0
    return 0.5 * min((now - 0.5) / 2.0, 1.0), 0.3 * math.sin(0.4 * now)


def pose_of(message: Any) -> Pose:
    pose = message.pose.pose
    return (
        pose.position.x,
        pose.position.y,
        2.0 * math.atan2(pose.orientation.z, pose.orientation.w),
    )


def relative(pose: Pose, start: Pose) -> Pose:
    """Returns a pose in the frame of ``start``."""
    dx, dy = pose[0] - start[0], pose[1] - start[1]
    c, s = math.cos(start[2]), math.sin(start[2])
    yaw = math.remainder(pose[2] - start[2], math.tau)
    return c * dx + s * dy, c * dy - s * dx, yaw


class Robot:
    """The topics of one robot: its twists, its odometry and its true motion."""

    def __init__(self, node: Any, namespace: str) -> None:
        space = f"/{namespace}" if namespace != "-" else ""
        self.twists = node.create_publisher(Twist, f"{space}/auto_nav/cmd_vel", 1)
        node.create_subscription(Odometry, f"{space}/odometry/base_raw", self._measured, 10)
        node.create_subscription(Odometry, f"{space}/odometry/true", self._true, 10)
        self.enable = node.create_client(SetBool, f"{space}/enable")
        self.state = node.create_client(Trigger, f"{space}/state")
        self.reset = node.create_client(Trigger, f"{space}/reset_faults")
        self.measured: Pose | None = None
        self.truths: dict[float, Pose] = {}
        self.time = 0.0
        self.start: tuple[Pose, Pose] | None = None
        self.path = 0.0
        self.moved_at = 0.0
        self._last: Pose | None = None
        self.frames: dict[str, str] = {}

    def _measured(self, message: Any) -> None:
        self.measured = pose_of(message)
        self.frames["measured"] = message.header.frame_id
        self.time = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9

    def _true(self, message: Any) -> None:
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        pose = pose_of(message)
        self.frames["true"] = message.header.frame_id
        if self._last is not None:
            step = math.dist(pose[:2], self._last[:2])
            self.path += step
            self.moved_at = stamp if step > 1e-6 else self.moved_at
        self._last = pose
        self.truths[round(stamp, 6)] = pose

    def pair(self) -> tuple[Pose, Pose] | None:
        """Returns the measured and the true pose of the same time."""
        truth = self.truths.get(round(self.time, 6))
        return (self.measured, truth) if self.measured and truth else None

    def send(self, vx: float, wz: float) -> None:
        message = Twist()
        message.linear.x, message.angular.z = vx, wz
        self.twists.publish(message)

    def result(self) -> dict[str, Any]:
        """Returns the errors, and the frames and the first poses of the topics."""
        pair = self.pair()
        assert pair is not None
        assert self.start is not None
        measured, true = (relative(now, start) for now, start in zip(pair, self.start, strict=True))
        distance = math.dist(measured[:2], true[:2])
        yaw = abs(math.remainder(measured[2] - true[2], math.tau))
        starts = dict(zip(("measured", "true"), self.start, strict=True))
        places = {name: (frame, starts[name]) for name, frame in self.frames.items()}
        return {"path": self.path, "distance": distance, "yaw": yaw, **places}


@functools.cache
def executor_of(node: Any) -> SingleThreadedExecutor:
    """Returns the executor of a node; ``rclpy.spin_once`` adds the node at each call, which takes
    longer than most callbacks."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    return executor


def wait(node: Any, what: str, condition: Any) -> None:
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end, what
        executor_of(node).spin_once(timeout_sec=0.05)


def call(node: Any, client: Any, request: Any) -> Any:
    wait(node, client.srv_name, client.service_is_ready)
    future = client.call_async(request)
    wait(node, client.srv_name, future.done)
    return future.result()


def main() -> None:
    seconds, namespaces = float(sys.argv[1]), sys.argv[2].split(",")
    rclpy.init()
    node = rclpy.create_node("mission")
    robots = [Robot(node, namespace) for namespace in namespaces]
    for robot in robots:
        wait(node, "the odometry", robot.pair)
    for robot in robots:
        end = time.monotonic() + TIMEOUT
        while not (answer := call(node, robot.enable, SetBool.Request(data=True))).success:
            assert time.monotonic() < end, answer.message
            call(node, robot.reset, Trigger.Request())  # the engine may have run away before
        wait(node, "the odometry", robot.pair)
        robot.start, robot.path = robot.pair(), 0.0
    continues = node.create_publisher(Float64, "/engine/continue", 1)
    begin = robots[0].time
    for turn in itertools.count():
        if (now := robots[0].time - begin) >= seconds:
            break
        for robot in robots:
            # A robot that missed its zero, or had a gap in time, wants zero first.
            stands = robot.time - robot.moved_at > 0.5 and turn % 5 == 0
            robot.send(*((0.0, 0.0) if stands else twist_at(now, seconds)))
        continues.publish(Float64(data=robots[0].time))
        wait(node, "the time of the engine", lambda now=now: robots[0].time - begin > now)
    states = [json.loads(call(node, robot.state, Trigger.Request()).message) for robot in robots]
    for robot in robots:
        wait(node, "the odometry", robot.pair)
    results = {
        name: {**robot.result(), "fault": state["fault"]}
        for name, robot, state in zip(namespaces, robots, states, strict=True)
    }
    print(json.dumps(results))


if __name__ == "__main__":
    main()
