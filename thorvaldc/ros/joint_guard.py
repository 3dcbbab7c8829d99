"""A node that stops the drives in another program when the base driver is silent.

Gazebo and the controllers of ros2_control keep the last command for ever.  If the process of the
base driver ends without a last command, the robot would drive on.  This node, in a process of its
own, hears the heartbeat of the base driver, and commands the speed 0 to all drives while it is
missing.  In a simulation it measures the time by ``/clock``, so that a pause is no silence.  A
driver that lives without joint states stops the drives itself.

A message costs a node in Python a millisecond, and ``/clock`` comes 100 times per second.  So the
guard hears it only while the heartbeat is late in real time, and compares it with the stamp of the
last heartbeat.  Without a simulation, the real time since the arrival of the heartbeat counts: the
clocks of two computers differ.
"""

from __future__ import annotations

import math
import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy

from thorvaldc.model.joint_topics import HEARTBEAT
from thorvaldc.ros.joint_messages import JointCommandTopics
from thorvaldc.ros.message_wait import handle_messages
from thorvaldc.ros.node_parameters import declared, declared_model

NODE_NAME = "joint_guard"
LONGEST_SILENCE = 0.2
"""Time (s) without a heartbeat of the base driver after which the drives are stopped; in a fast
simulation not before ``_LATE`` in real time."""
_PERIOD = 0.05
"""Real time (s) between two looks at the heartbeat, and two commands to silent drives."""
_LATE = 0.1
"""Real time (s) without a heartbeat after which the guard hears ``/clock``."""
_CALM = 5.0
"""Real time (s) without a late heartbeat after which it no longer does."""


class JointGuard(Node):  # type: ignore[misc]
    """The guard of one robot, with the parameters ``model_file``, ``use_node_namespace`` and
    ``joint_topics``."""

    def __init__(self, **options: Any) -> None:
        """Raises ``NodeError`` or ``DiagnosticError`` if a parameter or the model is wrong."""
        super().__init__(NODE_NAME, **options)
        dialect = declared(self, "joint_topics")
        self.values = {"autostart": False}
        self._commands = JointCommandTopics(self, declared_model(self), dialect)
        self._heard_at = -math.inf  # real time
        self._stamp = -math.inf  # of the last heartbeat, s
        self._late_at = 0.0  # real time
        self._clock_was = 0.0  # s
        self._stops = False
        self._is_simulated = bool(self.get_parameter("use_sim_time").value)
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._heartbeats = self.create_subscription(Time, HEARTBEAT, self._hear, qos)
        self._next_look = 0.0  # real time

    def _hear(self, message: Any) -> None:
        self._stamp = message.sec + message.nanosec * 1e-9
        self._heard_at = time.monotonic()

    def _watch(self) -> None:
        now = time.monotonic()
        self._next_look = now + _PERIOD
        silence = now - self._heard_at
        is_late = silence > _LATE
        if is_late:
            self._late_at = now
        if self._is_simulated:
            self._hear_clock(now - self._late_at < _CALM)
            silence = self._simulated_silence() if is_late else 0.0
        stops = silence > LONGEST_SILENCE
        if stops and not self._stops and math.isfinite(silence):
            self.get_logger().warning("the base driver is silent: the drives are stopped")
        self._stops = stops
        if stops:
            self._commands.stop()

    def _simulated_silence(self) -> float:
        """Returns the time (s) of ``/clock`` since the last heartbeat."""
        clock = self._ros_time()
        if clock != self._clock_was:  # it runs; a stamp ahead of it is of the time before a reset
            self._stamp = min(self._stamp, clock)
            self._clock_was = clock
        return clock - self._stamp

    def _hear_clock(self, hears: bool) -> None:
        if hears != self.get_parameter("use_sim_time").value:
            self.set_parameters([Parameter("use_sim_time", value=hears)])
            self._clock_was = self._ros_time()  # the time that was heard last

    def _ros_time(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    # -- as the node of the base driver, see ``run_nodes`` -----------------------------------------

    def wait(self) -> float:
        return self._next_look - time.monotonic()

    def await_states(self, longest: float) -> float | None:
        """Waits for heartbeats; other messages are handled together, once per look."""
        end = time.monotonic() + longest
        while (left := end - time.monotonic()) > 0.0:
            handle_messages(self, [self._heartbeats], longest=left)
        return 0.0

    def run_due(self) -> None:
        if self.wait() <= 0.0:
            self._watch()

    def stop_robot(self) -> None:
        # The launch ends this node when the base driver is killed: this command is the last one.
        self._commands.close()
