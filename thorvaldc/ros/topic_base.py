"""The base `topics`: the joints of the robot are in another program, behind ROS topics.

The other program is a simulation (Gazebo, Isaac Sim) or a controller manager of ros2_control.  It
gives the time: a control cycle runs for each set of joint states that is a period newer than the
last one, and its time is their stamp::

    joint states   |        |        |        |        .        .        |
    cycles         |        |        |        |        .   f  f  f       |    f: cycles in a fault
    silence                                   |<- 0.1 ->|

While the time of the other program stands, nothing happens.  While it goes on without joint states,
the base is in a fault, which a person must reset.  The other program keeps the last commands, so
that the base driver stops the robot by its commands in a fault, too.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from thorvaldc.model import Robot, wheel_joints
from thorvaldc.model.joint_topics import HEARTBEAT
from thorvaldc.ros.joint_messages import STATES_TOPICS, JointCommandTopics, JointStateReader
from thorvaldc.ros.message_wait import handle_messages
from thorvaldc.ros.parameters import JOINT_STATES, default_silence
from thorvaldc.runtime.base_interface import BaseHandle, ComponentStatus, JointCommands, JointStates
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.motion_supervision import Axis, Deviation
from thorvaldc.runtime.pace import Pace

LARGEST_LAG = 0.5
"""Largest difference (s) between the stamp of joint states and the time of ROS."""
JUMP = 1.0
"""Time (s) of the driver that passes when the stamps jump back.  The odometry takes the motion of
the robot in so long a time as unknown."""
_LOOK = 0.02
"""Longest real time (s) between two looks at the age of the joint states."""
_EARLY = 0.25
"""Share of a period by which joint states may come early: stamps are not quite regular."""
_HEARTBEAT = 0.035
"""Least time (s) between two heartbeats for the guard, which misses them after 0.2 s."""


class TopicBase(BaseHandle):
    """The joints of one robot behind topics, and the time of their stamps.

    It is the clock of its robot too: ``now`` is the time (s) since the first joint states.
    """

    gaps_are_faults = True  # the other program keeps the last commands

    def __init__(
        self, node: Any, robot: Robot, dialect: str, longest_silence: float | None = None
    ) -> None:
        """Creates the topics on ``node``, in its name space.

        ``longest_silence``: time (s) of ROS without usable joint states after which the base is in
        a fault; by default as ``default_silence`` says.
        """
        self._node = node
        self._wheels = len(robot.wheels)
        self._commands = JointCommandTopics(node, robot, dialect)
        self._alive = node.create_publisher(Time, HEARTBEAT, 1)
        self._beat = -math.inf  # time of the last heartbeat
        self._reader = JointStateReader(robot, wrapped=dialect == JOINT_STATES)
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # hears every sender
        topic = STATES_TOPICS[dialect]
        self._subscription = node.create_subscription(JointState, topic, self.take, qos)
        self._topic = self._subscription.topic_name
        self._states: JointStates | None = None
        self._stamp = 0  # ns
        self._origin = 0  # ns; the stamp at the time 0
        self._time = 0.0  # of the newest joint states, or of their absence
        self._silence = 0.0
        self._longest_silence = longest_silence or default_silence(robot)
        self._looked = self._ros_time()
        self._messages = 0
        self._waited_at = -1  # number of messages at the end of the last wait for nothing
        self._fault = ""
        self._disobedience = ""
        self._refusal = ""
        drives, steering = wheel_joints(robot)
        self._axes = [
            Axis(motor, wheel, f"joint {joint}")
            for joint, wheel in (*drives.items(), *steering.items())
            if (motor := robot.actuator_of(joint)) is not None
        ]

    # -- joint states and their time -----------------------------------------------------------

    def take(self, message: Any) -> None:
        """Takes joint states; those that are not usable count as missing."""
        self._messages += 1
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if self._states is None:
            self._origin = stamp
        jump = (stamp - self._stamp) * 1e-9 if self._states is not None else 0.0
        origin = self._origin
        if jump < 0.0:
            origin = stamp - round((self._time + JUMP) * 1e9)
        now = (stamp - origin) * 1e-9
        self._refusal = self._refusal_of(stamp, jump)
        if self._refusal:
            return
        try:
            states = self._reader.read(message, now)
        except ValueError as error:
            self._refusal = f"the joint states on {self._topic} are not usable: {error}"
            return
        if jump < 0.0:
            self.fail(f"the time of the joint states jumped back by {-jump:.3f} s")
        self._states = states
        self._stamp, self._origin, self._time = stamp, origin, max(now, self._time)
        self._silence, self._looked = 0.0, self._ros_time()

    def _refusal_of(self, stamp: int, jump: float) -> str:
        """Returns why joint states with this stamp (ns) are not usable, or an empty text."""
        lag = self._ros_time() - stamp * 1e-9
        if stamp == 0:
            # A Gazebo that is paused from its start sends them with the time 0.
            return (
                f"the joint states on {self._topic} have no stamp; if a simulation sends them,"
                " start it: its time is 0"
            )
        if self._states is not None and jump == 0.0:
            return f"the joint states on {self._topic} have the same stamp again and again"
        if abs(lag) > LARGEST_LAG:
            side = "behind" if lag > 0.0 else "ahead of"
            return (
                f"the stamps of the joint states on {self._topic} are {abs(lag):.3g} s {side} the"
                " time of this node; is `use_sim_time` right?"
            )
        return ""

    def look(self) -> None:
        """Notes the time without joint states, which is a fault if it is too long.

        A time in which this program could not look does not count: messages may wait.
        """
        now = self._ros_time()
        elapsed = min(max(now - self._looked, 0.0), 2.0 * _LOOK)
        self._looked = now
        self._silence += elapsed
        if self._states is not None and self._silence > self._longest_silence:
            self.fail(self._refusal or f"no joint states on {self._topic}")
            self._time = max(self._time, self._states.time + self._silence)

    def poll(self, longest: float) -> None:
        """Waits until new joint states are taken, for at most ``longest`` s of real time."""
        end, messages = time.monotonic() + longest, self._messages
        while self._messages == messages and (left := end - time.monotonic()) > 0.0:
            handle_messages(self._node, [self._subscription], longest=left)

    @property
    def now(self) -> float:
        return self._time

    def sleep_until(self, when: float) -> None:
        """Waits for joint states of the time ``when`` (s); goes on in a fault if none come.

        So a robot also ends while the other program is paused or has ended.  Only the first wait
        without a message is that long: the cycles of a stop would last minutes.
        """
        silent = self._messages == self._waited_at
        end = time.monotonic() + (when - self._time if silent else self._longest_silence)
        while self._time < when and time.monotonic() < end:
            self.poll(end - time.monotonic())
        if self._time < when:
            self.fail(f"no joint states on {self._topic}")
            self._time = when
            self._waited_at = self._messages

    @property
    def has_time(self) -> bool:
        """Whether joint states have come, so that the time runs."""
        return self._states is not None

    @property
    def stamp(self) -> int:
        """Stamp (ns) of the present time."""
        return self._origin + round(self._time * 1e9)

    def _ros_time(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    # -- the base --------------------------------------------------------------------------------

    @property
    def hold_reason(self) -> str:
        refusal = self._refusal or f"no joint states have come on {self._topic} yet"
        return refusal if self._states is None else ""

    @property
    def disarming_reason(self) -> str:
        # A joint that does not obey is named also in a fault of another kind.
        return "; ".join(filter(None, (self._fault, self._disobedience)))

    @property
    def longest_interval(self) -> float:
        return self._longest_silence + 3.0 * _LOOK  # a fault notices the silence before

    @property
    def _problem(self) -> str:
        return self.disarming_reason or self.hold_reason

    @property
    def lacks_joint_states(self) -> bool:
        """Whether the present time has no joint states."""
        return self._states is None or self._states.time < self._time

    def read(self, now: float) -> JointStates:
        if self._states is not None and not self.lacks_joint_states:
            self._measure(self._states)
            return self._states
        for axis in self._axes:
            axis.follows = False
        unknown = [math.nan] * self._wheels
        return JointStates(now, unknown, unknown, unknown, unknown)

    def _measure(self, states: JointStates) -> None:
        """Takes the motion of the motors from their positions, as the odometry does."""
        positions = states.positions or ()  # the reader refuses a message without them
        for axis in self._axes:
            if states.time > axis.time:
                position = (states.angles if axis.steering else positions)[axis.wheel]
                axis.update(states.time, position)

    @property
    def axes(self) -> Sequence[Axis]:
        return self._axes

    def other_joints(self) -> Mapping[str, tuple[float, float]]:
        return self._reader.others

    def write(self, commands: JointCommands, now: float) -> None:
        if not 0.0 <= now - self._beat < _HEARTBEAT:
            self._alive.publish(self._node.get_clock().now().to_msg())
            self._beat = now
        if self._states is not None:  # the angles of the steering are unknown before
            self._commands.send(commands)
            for axis in self._axes:
                axis.target = (commands.angles if axis.steering else commands.speeds)[axis.wheel]
                axis.follows = math.isfinite(axis.position)

    def fail(self, reason: str) -> None:
        self._fault = self._fault or reason

    def disobeyed(self, deviations: Sequence[Deviation], now: float) -> None:
        motors = ", ".join(text for _, text in deviations)
        if not self._disobedience:
            self._disobedience = f"by the joint states on {self._topic}, {motors}"

    def reset(self, now: float, commanded: bool) -> str:
        if self._silence > self._longest_silence:
            return self._problem
        if commanded:
            return "a motion is commanded; command zero first"
        self._fault = self._disobedience = ""
        return ""

    def values(self) -> dict[str, Any]:
        return {"fault": self._problem}

    def warnings(self, now: float) -> list[str]:
        if self._alive.get_subscription_count():
            return []
        return [
            f"no joint_guard hears {self._alive.topic_name}: if this node is killed, nothing stops"
            " the drives"
        ]

    def component_statuses(self, now: float) -> Iterable[ComponentStatus]:
        values = {"topic": self._topic, "messages": self._messages, "silence": self._silence}
        level = "error" if self._problem else "ok"
        yield ComponentStatus("joint topics", level, self._problem or "ok", values)

    def close(self) -> None:
        self._commands.close()
        self._node.destroy_publisher(self._alive)
        self._node.destroy_subscription(self._subscription)


class StampPace(Pace):
    """Control cycles for joint states that are a period newer than those of the last cycle."""

    def __init__(self, base: TopicBase, period: float) -> None:
        super().__init__(base, period)
        self._base = base

    def wait(self) -> float:
        self._base.look()
        return 0.0 if self._base.has_time and super().wait() <= 0.0 else _LOOK

    def end(self, begun: float) -> None:
        super().end(begun)
        self._deadline = begun + (1.0 - _EARLY) * self.period


def robot_behind_topics(
    node: Any, robot: Robot, dialect: str, longest_silence: float | None = None
) -> DrivenRobot:
    """Returns the robot of a node on the base `topics`; for the silence see ``TopicBase``."""
    base = TopicBase(node, robot, dialect, longest_silence)
    try:
        return DrivenRobot(robot, base, base, pace=StampPace(base, 1.0 / robot.driver.rate))
    except BaseException:
        base.close()
        raise
