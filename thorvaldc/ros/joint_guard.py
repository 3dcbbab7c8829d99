"""A node that stops the drives in another program when the base driver is silent.

Gazebo and the controllers of ros2_control keep the last command for ever.  If the process of the
base driver ends without a last command, the robot would drive on.  This node, in a process of its
own, hears the heartbeat of the base driver, and commands the speed 0 to all drives while it is
missing.  It measures the time by the clock of ROS, so that a paused simulation is no silence.  A
driver that lives without joint states stops the drives itself.

A message costs a node in Python a millisecond, and ``/clock`` comes 100 times per second.  So the
guard hears it only while the heartbeat is late in real time; the heartbeat has a stamp.
"""

from __future__ import annotations

import math
import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy

from thorvaldc.model.joint_topics import HEARTBEAT
from thorvaldc.ros.joint_messages import JointCommandTopics
from thorvaldc.ros.node_parameters import declared, load_robot_model

NODE_NAME = "joint_guard"
LONGEST_SILENCE = 0.2
"""Time (s) of ROS without a heartbeat of the base driver after which the drives are stopped."""
_PERIOD = 0.05
"""Real time (s) between two looks at the heartbeat, and two commands to silent drives."""
_LATE = 0.1
"""Real time (s) without a heartbeat after which the guard hears ``/clock``."""
_CALM = 5.0
"""Real time (s) without a late heartbeat after which it no longer does."""


class JointGuard(Node):  # type: ignore[misc]
    """The guard of one robot, with the parameters ``model_file`` and ``joint_topics``."""

    def __init__(self, **options: Any) -> None:
        """Raises ``NodeError`` or ``DiagnosticError`` if a parameter or the model is wrong."""
        super().__init__(NODE_NAME, **options)
        model_file, dialect = (declared(self, name) for name in ("model_file", "joint_topics"))
        self.values = {"autostart": False}
        self._commands = JointCommandTopics(self, load_robot_model(model_file), dialect)
        self._heard = self._looked_at = -math.inf  # times of ROS
        self._heard_at = self._late_at = time.monotonic()
        self._stops = False
        self._is_simulated = bool(self.get_parameter("use_sim_time").value)
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Time, HEARTBEAT, self._hear, qos)
        self.create_timer(_PERIOD, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _hear(self, message: Any) -> None:
        self._heard = message.sec + message.nanosec * 1e-9
        self._heard_at = time.monotonic()

    def _watch(self) -> None:
        now = time.monotonic()
        if now - self._heard_at > _LATE:
            self._late_at = now
        self._hear_clock(self._is_simulated and now - self._late_at < _CALM)
        if now > self._late_at:
            self._stops, self._looked_at = False, -math.inf
            return
        time_of_ros = float(self.get_clock().now().nanoseconds) * 1e-9
        # The first look after a calm time may see the time that was heard last.
        if time_of_ros < self._looked_at:  # a jump back
            self._heard = min(self._heard, time_of_ros)
        self._looked_at = time_of_ros
        silence = time_of_ros - self._heard
        stops = silence > LONGEST_SILENCE
        if stops and not self._stops and math.isfinite(silence):
            self.get_logger().warning("the base driver is silent: the drives are stopped")
        self._stops = stops
        if stops:
            self._commands.stop()

    def _hear_clock(self, hears: bool) -> None:
        if hears != self.get_parameter("use_sim_time").value:
            self.set_parameters([Parameter("use_sim_time", value=hears)])

    # -- as the node of the base driver, see ``run_nodes`` -----------------------------------------

    def wait(self) -> float:
        return math.inf

    def run_due(self) -> None:
        return

    def stop_robot(self) -> None:
        self._commands.stop()
