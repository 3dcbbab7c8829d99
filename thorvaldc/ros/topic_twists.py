"""Twists of ROS topics, on their way to the twist multiplexer, and the watch of a ROS clock."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from thorvaldc.model import Robot
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.se2 import Twist

LONGEST_WAIT = 10.0
"""Longest time (s) that a twist counts as having waited in the middleware.

The time is the difference of the clocks of two computers.  If the clock of the sender is late, its
twists are refused for at most this time after a gap, and not for ever.
"""
OWNER = "ROS"
"""Name of all ROS programs as owners of twist sources and stops: ROS does not tell who sends."""


class TwistInputs:
    """Judges the twists of all sources, and counts those that are refused.

    ``refused``: number of refused twists and the newest reason, for each source.
    """

    def __init__(
        self,
        robot: Robot,
        values: Mapping[str, Any],
        warn: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Prepares the sources of ``robot``.

        ``values``: parameters of the node.  ``warn``: function that shows a warning.
        """
        self._values = values
        self._warn = warn
        self._without_stamp: set[str] = set()
        self.received = {source.name: 0 for source in robot.twist_sources}
        self.refused: dict[str, tuple[int, str]] = {}
        self._other_types: dict[str, str] = {}

    def publish_stamped(
        self,
        robot: DrivenRobot | None,
        source: str,
        message: Any,
        problem: str,
        ros_time: float,
        waited: float = 0.0,
    ) -> None:
        """Publishes a TwistStamped of a source that arrives at ``ros_time`` (s).

        A stamp of zero means now, as for the controllers of ros2_controllers.  ``waited``: as for
        ``publish``.
        """
        header = message.header
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9
        age = ros_time - stamp if stamp else 0.0
        if not stamp and source not in self._without_stamp:
            self._without_stamp.add(source)
            self._warn(f"the twists of `{source}` have a stamp of zero: they count as sent now")
        base_frame = self._values["base_frame_id"]
        if not problem and header.frame_id not in ("", base_frame):
            problem = (
                f"the twist is in the frame `{header.frame_id}`; `{base_frame}` and an empty frame"
                " are accepted"
            )
        self.publish(robot, source, message.twist, problem, age, waited)

    def publish(
        self,
        robot: DrivenRobot | None,
        source: str,
        message: Any,
        problem: str,
        age: float = 0.0,
        waited: float = 0.0,
    ) -> None:
        """Publishes a ROS twist of a source that is ``age`` seconds old.

        - ``problem``: reason why the twist does not count, or an empty text;
        - ``waited``: real time (s) since the message was published, by the clocks of sender and
          receiver.
        """
        self.received[source] += 1
        twist = Twist(message.linear.x, message.linear.y, message.angular.z)
        waited = min(max(waited, 0.0), LONGEST_WAIT)
        reason = problem or self._refusal(robot, twist, age, waited)
        if robot is not None and not reason:
            sent = robot.input_time - max(age, 0.0)
            reason = robot.multiplexer.publish(source, twist, sent, OWNER)
        if reason:
            count, _ = self.refused.get(source, (0, ""))
            self.refused[source] = (count + 1, reason)

    def _refusal(self, robot: DrivenRobot | None, twist: Twist, age: float, waited: float) -> str:
        if robot is None:
            return "the node is inactive"
        if robot.paused:
            return "the simulation is paused"
        if reason := robot.void_reason(waited):
            return reason
        if not all(map(math.isfinite, twist)):
            return "the twist is not finite"
        longest, lead = self._values["max_command_age"], self._values["max_command_lead"]
        if age > longest:
            return f"the twist is {age:.3f} s old; max_command_age is {longest:g} s"
        if age < -lead:
            return (
                f"the stamp of the twist is {-age:.3f} s in the future;"
                f" max_command_lead is {lead:g} s"
            )
        return ""

    def note_types(self, source: str, published: Iterable[str], taken: str) -> None:
        """Notes of which types the twists of a source are published; only one is ``taken``.

        The middleware delivers no message of another type, and tells nobody.
        """
        others = ", ".join(sorted({*published} - {taken}))
        text = others and f"a program sends {others}; the node takes {taken} (parameter `stamped`)"
        if text and text != self._other_types.get(source):
            self._warn(f"`{source}`: {text}")
        self._other_types[source] = text

    def summary(self) -> dict[str, Any]:
        """Returns the counts and reasons for the diagnostics."""
        values: dict[str, Any] = {}
        for source, received in self.received.items():
            count, reason = self.refused.get(source, (0, ""))
            reason = self._other_types.get(source) or reason
            values[source] = {"received": received, "refused": count, "reason": reason}
        return values


# -- watches a clock of ROS that another node publishes -----------------------------------------

LONGEST_JUMP = 1.0
"""Largest forward step (s) of the clock between two control cycles that is no jump."""


class ClockWatch:
    """Notices that a clock stands still or jumps.

    ``problem``: reason why no command counts at present, or an empty text.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._follows: bool | None = None
        self._ros_time = math.nan
        self._moved = math.nan

    def update(self, ros_time: float | None, now: float, longest_stand: float) -> str:
        """Judges the time ``ros_time`` (s) of the clock at the real time ``now`` (s).

        - ``ros_time``: ``None`` while the time is that of the computer, which needs no watch;
        - ``longest_stand``: longest real time (s) for which the clock may stand.

        Returns the description of a jump, or an empty text.
        """
        follows = ros_time is not None
        switched = follows is not self._follows and self._follows is not None
        first = switched or self._follows is None
        self._follows = follows
        last, self._ros_time = self._ros_time, math.nan if ros_time is None else ros_time
        step = 0.0 if first else self._ros_time - last
        if ros_time is None:
            self.problem = ""
        elif first:  # without a message it is 0, or the time of an earlier message
            self._moved = math.inf
            self.problem = "the clock /clock has not run yet"
        elif step != 0.0:
            self._moved = now
            self.problem = ""
        elif now - self._moved > longest_stand:
            self.problem = f"the clock /clock stands still at {ros_time:.3f} s"
        if switched:
            return f"use_sim_time has become {str(follows).lower()}"
        if step < 0.0:
            return f"the clock /clock jumped back by {-step:.3f} s"
        if step > LONGEST_JUMP:
            return f"the clock /clock jumped by {step:.3f} s"
        return ""
