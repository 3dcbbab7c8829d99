"""Gazebo and its bridge for the tests: robots in another process, behind the generated topics.

``python -m tests.ros.engines.gazebo_engine --physics mujoco|dart --python PYTHON --file FILE
PACKAGE ...`` simulates the packages in one world.  ``FILE`` is the MJCF scene or the SDF world;
``PYTHON`` is the Python that has the physics engine.

The bridge connects what ``config/gz_bridge.yaml`` of each package says (ros_gz_bridge,
src/bridge_config.cpp and src/convert/).  ``/clock`` comes 100 times in a simulated second, as the
launch file of Gazebo passes it on.  A paused Gazebo goes on to publish the time, which stands, and
joint states if it has published them at this very time (JointStatePublisher.cc does not ask for
the pause).  With ``--lockstep``, the
simulation waits for the commands of each cycle, so that its results do not depend on the load of
the computer; it also waits for a client that says on ``/engine/continue`` (Float64) until which
time (s) it has sent its twists.  The factor 0 is as fast as possible.

Faults come as JSON on the topic ``/engine/fault``: ``mute``, ``pause``, ``reset``, ``factor``.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
import yaml
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from tests.child_process import ChildProcess
from tests.ros.engines import gazebo_world

TYPES = {
    ("std_msgs/msg/Float64", "gz.msgs.Double"): Float64,
    ("sensor_msgs/msg/JointState", "gz.msgs.Model"): JointState,
    ("nav_msgs/msg/Odometry", "gz.msgs.Odometry"): Odometry,
}
"""Pairs of types that ros_gz_bridge converts (its README.md), of topics that are simulated."""
SENSOR_TYPES = {
    ("sensor_msgs/msg/CameraInfo", "gz.msgs.CameraInfo"),
    ("sensor_msgs/msg/Image", "gz.msgs.Image"),
    ("sensor_msgs/msg/Imu", "gz.msgs.IMU"),
    ("sensor_msgs/msg/LaserScan", "gz.msgs.LaserScan"),
    ("sensor_msgs/msg/NavSatFix", "gz.msgs.NavSat"),
    ("sensor_msgs/msg/PointCloud2", "gz.msgs.PointCloudPacked"),
}
ENTRY = {"ros_topic_name", "gz_topic_name", "ros_type_name", "gz_type_name", "direction"}
"""Keys of an entry of the bridge; it would ignore others, or change its queues for them."""
CLOCK_PERIOD = 10_000_000  # ns
LONGEST_WAIT = 1.0
"""Longest real time (s) for which the simulation waits for commands with ``--lockstep``."""


class EngineError(Exception):
    """The files do not fit together; the message is one line."""


class World:
    """The child process with the physics."""

    def __init__(self, options: argparse.Namespace) -> None:
        command = [options.python, gazebo_world.__file__]
        self._process = ChildProcess(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        setup = {
            "packages": [str(package) for package in options.packages],
            "physics": options.physics,
            "file": str(options.file),
            "places": json.loads(options.places or "null") or [[0.0] * 3] * len(options.packages),
        }
        answer = self.ask(setup)
        if "error" in answer:
            raise EngineError(answer["error"])
        self.robots: list[dict[str, Any]] = answer["robots"]

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answer

    def close(self) -> None:
        self._process.end()


def period_of(rate: float) -> int:
    """Returns the period (ns) of a rate (Hz); 0 is each step."""
    return int(1e9 / rate) if rate > 0.0 else 1


class Engine:
    """The nodes of the bridges, and the loop of the simulation."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.world = World(options)
        self.clock_node = rclpy.create_node("gazebo")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.clock_node)
        self._clock = self.clock_node.create_publisher(Clock, "/clock", 1)
        self.clock_node.create_subscription(String, "/engine/fault", self._on_fault, 10)
        self.clock_node.create_subscription(Float64, "/engine/continue", self._on_continue, 10)
        self.continued: float | None = None
        self.commands: dict[str, float] = {}
        self.fresh: set[str] = set()
        self.heard = False
        self.bridges: list[tuple[Any, Any]] = []
        for package, robot in zip(options.packages, self.world.robots, strict=True):
            self._add_bridge(package, robot)
        self.muted = self.paused = self.resets = False
        self.factor = float(options.factor)
        self.answer: dict[str, Any] = {"time": 0}
        self._begin()
        self.sent = 0.0
        self.statistics = {"cycles": 0, "complete": 0}
        self.latencies: list[float] = []
        self.ended = False

    def _add_bridge(self, package: Path, robot: dict[str, Any]) -> None:
        namespace = self.options.namespaces.split(",")[len(self.bridges)]
        node = rclpy.create_node("gz_bridge", namespace=namespace or None)
        self.executor.add_node(node)
        states = odometry = None
        commands = set(robot["commands"])
        publishes = {robot["states"]: JointState, robot["odometry"]: Odometry}
        entries = yaml.safe_load((package / "config" / "gz_bridge.yaml").read_text())
        for entry in entries:
            if entry.keys() != ENTRY:
                raise EngineError(f"the bridge has an entry with {', '.join(sorted(entry))}")
            gazebo, ros = entry["gz_topic_name"].strip("/"), entry["ros_topic_name"]
            pair = entry["ros_type_name"], entry["gz_type_name"]
            kind, direction = TYPES.get(pair), entry["direction"]
            if pair in SENSOR_TYPES and direction == "GZ_TO_ROS":
                continue
            if kind is Float64 and direction == "ROS_TO_GZ" and gazebo in commands:
                commands.remove(gazebo)
                node.create_subscription(kind, ros, lambda m, t=gazebo: self._take(t, m), 10)
            elif kind and direction == "GZ_TO_ROS" and publishes.get(gazebo) is kind:
                publisher = node.create_publisher(kind, ros, 10)
                if kind is JointState:
                    states = publisher
                else:
                    odometry = publisher
            else:
                raise EngineError(f"no system has the topic {gazebo} with {direction}, {pair}")
        if commands or states is None or odometry is None:
            raise EngineError(f"the bridge leaves out {', '.join(sorted(commands)) or 'states'}")
        self.bridges.append((states, odometry))

    # -- topics --------------------------------------------------------------------------------

    def _take(self, topic: str, message: Any) -> None:
        self.commands[topic] = message.data
        self.fresh.add(topic)
        self.heard = True

    def _on_continue(self, message: Any) -> None:
        self.continued = message.data

    def _on_fault(self, message: Any) -> None:
        fault = json.loads(message.data)
        self.muted = fault.get("mute", self.muted)
        self.paused = fault.get("pause", self.paused)
        self.resets = fault.get("reset", self.resets)
        self.factor = fault.get("factor", self.factor)

    def publish_states(self, index: int) -> None:
        robot = self.answer["robots"][index]
        message = JointState(
            name=robot["names"], position=robot["positions"], velocity=robot["velocities"]
        )
        # The bridge copies the force of each joint, which no system of the world fills in.
        message.effort = [0.0] * len(message.name)
        message.header.stamp = self.stamp
        if not self.muted:
            self.bridges[index][0].publish(message)

    def publish_odometry(self, index: int) -> None:
        place, twist = self.answer["robots"][index]["motion"]
        truth = Odometry()
        truth.header.stamp = self.stamp
        frames = (name.replace("::", "/") for name in self.world.robots[index]["frames"])
        truth.header.frame_id, truth.child_frame_id = frames
        truth.pose.pose.position.x, truth.pose.pose.position.y = place[:2]
        truth.pose.pose.orientation.z = math.sin(0.5 * place[2])
        truth.pose.pose.orientation.w = math.cos(0.5 * place[2])
        truth.twist.twist.linear.x, truth.twist.twist.linear.y = twist[:2]
        truth.twist.twist.angular.z = twist[2]
        self.bridges[index][1].publish(truth)

    def publish_clock(self) -> None:
        self._clock.publish(Clock(clock=self.stamp))

    # -- the loop ------------------------------------------------------------------------------

    @property
    def expected(self) -> int:
        return sum(len(robot["commands"]) for robot in self.world.robots)

    @property
    def now_ns(self) -> int:
        return int(self.answer["time"])

    @property
    def now(self) -> float:
        return self.now_ns * 1e-9

    @property
    def stamp(self) -> Time:
        return Time(sec=self.now_ns // 10**9, nanosec=self.now_ns % 10**9)

    def _begin(self) -> None:
        """Gives the times (ns) of the first messages.

        A publisher sends in the first step that is a period after its last message, or after 0.
        """
        robots = self.world.robots
        self.clock_due = CLOCK_PERIOD
        self.states_due = [period_of(robot["rate"]) for robot in robots]
        self.odometry_due = [period_of(robot["odometry_rate"]) for robot in robots]

    def run(self) -> None:
        """Simulates until a signal comes."""
        due = time.perf_counter()
        while not self.ended:
            if self.paused:
                self._stand()
                due = time.perf_counter()
                continue
            if self.resets:
                self._begin()
            before = 0 if self.resets else self.now_ns
            until = min(self.clock_due, *self.states_due, *self.odometry_due)
            request = {"commands": self.commands, "until": until, "reset": self.resets}
            self.resets, self.commands = False, {}
            self.answer = self.world.ask(request)
            is_cycle = self._publish_due()
            due += (self.now_ns - before) * 1e-9 / self.factor if self.factor else 0.0
            self._wait(due)
            if is_cycle:
                self._wait_for_commands()
            due = max(due, time.perf_counter() - 0.5)

    def _publish_due(self) -> bool:
        """Publishes what is due; returns whether joint states were."""
        if self.now_ns >= self.clock_due:
            self.clock_due = self.now_ns + CLOCK_PERIOD
            self.publish_clock()
        is_cycle = False
        for index, robot in enumerate(self.world.robots):
            if self.now_ns >= self.states_due[index]:
                self.states_due[index] = self.now_ns + period_of(robot["rate"])
                self.publish_states(index)
                is_cycle = True
            if self.now_ns >= self.odometry_due[index]:
                self.odometry_due[index] = self.now_ns + period_of(robot["odometry_rate"])
                self.publish_odometry(index)
        if is_cycle:
            self.sent = time.perf_counter()
            self.fresh.clear()
        return is_cycle

    def _stand(self) -> None:
        self.publish_clock()
        for index, robot in enumerate(self.world.robots):
            last = self.states_due[index] - period_of(robot["rate"])
            if self.now_ns == last and self.now_ns:
                self.publish_states(index)
        self.executor.spin_once(timeout_sec=0.001)

    def _wait(self, due: float) -> None:
        while True:
            left = due - time.perf_counter()
            self.executor.spin_once(timeout_sec=max(left, 0.0))
            self._note_latency()
            if left <= 0.0:
                return

    def _note_latency(self) -> None:
        if self.sent and len(self.fresh) == self.expected:
            self.latencies.append(time.perf_counter() - self.sent)
            self.sent = 0.0

    def _wait_for_commands(self) -> None:
        end = time.perf_counter() + LONGEST_WAIT
        waits = self.options.lockstep and self.heard and not self.muted
        while waits and (self.sent or self._is_ahead()) and time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=0.01)
            self._note_latency()
        self.statistics["cycles"] += self.heard
        self.statistics["complete"] += self.heard and not self.sent

    def _is_ahead(self) -> bool:
        """Whether a client has not sent its twists for the present time yet."""
        return self.continued is not None and self.continued < self.now - 1e-6

    def report(self) -> dict[str, Any]:
        latencies = sorted(self.latencies) or [math.nan]
        return {
            **self.statistics,
            "time": self.now,
            "p50_ms": 1e3 * latencies[len(latencies) // 2],
            "p99_ms": 1e3 * latencies[int(0.99 * len(latencies))],
        }


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("packages", type=Path, nargs="+")
    parser.add_argument("--physics", choices=sorted(gazebo_world.PHYSICS), required=True)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--file", type=Path, required=True)
    parser.add_argument("--namespaces", default="")
    parser.add_argument("--places", default="")
    parser.add_argument("--factor", default="1.0")
    parser.add_argument("--lockstep", action="store_true")
    options = parser.parse_args()
    rclpy.init()
    try:
        engine = Engine(options)
    except EngineError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: setattr(engine, "ended", True))
    engine.run()
    engine.world.close()
    print(json.dumps(engine.report()), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
