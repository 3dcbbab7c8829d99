"""Twists of ROS topics, on their way to the twist multiplexer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from thorvaldc.model import Robot
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.se2 import Twist

OWNER = "ROS"
"""Name of all ROS programs as owners of twist sources and stops: ROS does not tell who sends."""
LARGEST_CLOCK_ERROR = 0.005
"""Largest time (s) by which a stamped twist may seem to come from the future."""


class TwistInputs:
    """Judges the twists of all sources, and counts those that are refused.

    ``refused``: number of refused twists and the newest reason, for each source.
    """

    def __init__(self, robot: Robot, values: Mapping[str, Any]) -> None:
        """Prepares the sources of ``robot``; ``values`` are the parameters of the node."""
        self._values = values
        self.received = {source.name: 0 for source in robot.twist_sources}
        self.refused: dict[str, tuple[int, str]] = {}

    def publish(
        self, robot: DrivenRobot | None, source: str, message: Any, problem: str, age: float = 0.0
    ) -> None:
        """Publishes a ROS twist of a source that is ``age`` seconds old.

        ``problem``: reason why no twist counts at present, or an empty text.
        """
        self.received[source] += 1
        twist = Twist(message.linear.x, message.linear.y, message.angular.z)
        reason = problem or self._refusal(robot, twist, age)
        if robot is not None and not reason:
            sent = robot.input_time - max(age, 0.0)
            reason = robot.multiplexer.publish(source, twist, sent, OWNER)
        if reason:
            count, _ = self.refused.get(source, (0, ""))
            self.refused[source] = (count + 1, reason)

    def _refusal(self, robot: DrivenRobot | None, twist: Twist, age: float) -> str:
        if robot is None:
            return "the node is inactive"
        if robot.paused:
            return "the simulation is paused"
        if reason := robot.void_reason():
            return reason
        if not all(map(math.isfinite, twist)):
            return "the twist is not finite"
        longest = self._values["max_command_age"]
        if age > longest:
            return f"the twist is {age:.3f} s old; max_command_age is {longest:g} s"
        if age < -LARGEST_CLOCK_ERROR:
            return f"the stamp of the twist is {-age:.3f} s in the future"
        return ""

    def summary(self) -> dict[str, Any]:
        """Returns the counts and reasons for the diagnostics."""
        values: dict[str, Any] = {}
        for source, received in self.received.items():
            count, reason = self.refused.get(source, (0, ""))
            values[source] = {"received": received, "refused": count, "reason": reason}
        return values
