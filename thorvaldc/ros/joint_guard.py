"""A node that stops the drives in another program when the base driver is silent.

Gazebo and the controllers of ros2_control keep the last command for ever.  If the process of the
base driver ends without a last command, the robot would drive on.  This node, in a process of its
own, hears the heartbeat of the base driver, and commands the speed 0 to all drives while it is
missing.  It measures the time by the clock of ROS, so that a paused simulation is no silence.  A
driver that lives without joint states stops the drives itself.
"""

from __future__ import annotations

import math
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Empty

from thorvaldc.model.joint_topics import HEARTBEAT
from thorvaldc.ros.joint_messages import JointCommandTopics
from thorvaldc.ros.node_parameters import declared, load_robot_model

NODE_NAME = "joint_guard"
LONGEST_SILENCE = 0.2
"""Time (s) of ROS without a heartbeat of the base driver after which the drives are stopped."""
_PERIOD = 0.05
"""Time (s) of ROS between two commands to silent drives."""


class JointGuard(Node):  # type: ignore[misc]
    """The guard of one robot, with the parameters ``model_file`` and ``joint_topics``."""

    def __init__(self, **options: Any) -> None:
        """Raises ``NodeError`` or ``DiagnosticError`` if a parameter or the model is wrong."""
        super().__init__(NODE_NAME, **options)
        model_file, dialect = (declared(self, name) for name in ("model_file", "joint_topics"))
        self.values = {"autostart": False}
        self._commands = JointCommandTopics(self, load_robot_model(model_file), dialect)
        self._heard = -math.inf
        self._stops = False
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Empty, HEARTBEAT, self._hear, qos)
        self.create_timer(_PERIOD, self._watch)

    def _hear(self, message: Any) -> None:
        self._heard = self._now()

    def _watch(self) -> None:
        silence = self._now() - self._heard
        if silence < 0.0:  # the clock has jumped back
            self._heard = self._now()
        stops = silence > LONGEST_SILENCE
        if stops and not self._stops and math.isfinite(silence):
            self.get_logger().warning("the base driver is silent: the drives are stopped")
        self._stops = stops
        if stops:
            self._commands.stop()

    def _now(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    # -- as the node of the base driver, see ``run_nodes`` -----------------------------------------

    def wait(self) -> float:
        return math.inf

    def run_due(self) -> None:
        return

    def stop_robot(self) -> None:
        self._commands.stop()
