"""A base driver with the base `topics` and an engine in one process, cycle by cycle.

The engine is a node that publishes joint states and hears commands.  Nothing depends on real time:
each cycle ends when the driver has taken the joint states and the engine has the commands.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from thorvaldc.model import Robot, wheel_joints
from thorvaldc.ros.lifecycle_node import BaseDriverNode
from thorvaldc.ros.node_parameters import load_robot_model
from thorvaldc.runtime.base_interface import JointCommands, JointStates

TIMEOUT = 120.0  # s, real time
SOURCE = "auto_nav"


def stamp(time_s: float) -> Time:
    nanoseconds = round(time_s * 1e9)
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


class TopicRig:
    """The node, its robot, and the engine.

    ``now`` is the time (s) of the engine; ``states`` are the joint states that it publishes.
    """

    def __init__(self, model_file: str, dialect: str) -> None:
        values = {
            "model_file": model_file,
            "base": "topics",
            "joint_topics": dialect,
            "use_sim_time": True,
            "stamped": False,
        }
        rclpy.init()
        self.model: Robot = load_robot_model(model_file)
        overrides = [Parameter(k, value=v) for k, v in values.items()]
        self.node = BaseDriverNode(parameter_overrides=overrides)
        self.engine = rclpy.create_node("engine")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.engine)
        self.work: Callable[[], None] = lambda: None  # of another node, in every wait
        self.now = 1.0
        wheels = len(self.model.wheels)
        zeros = [0.0] * wheels
        self.states = JointStates(self.now, zeros[:], zeros[:], zeros[:], zeros[:])
        self.commands = JointCommands(zeros[:], zeros[:])
        self.heard = 0
        self.odometry: list[Any] = []
        self.drives, self.steering = wheel_joints(self.model)
        self._clock = self.engine.create_publisher(Clock, "/clock", 1)
        topic = "engine/joint_states"
        if dialect == "ros2_control":
            topic = "joint_state_broadcaster/joint_states"
        self._publisher = self.engine.create_publisher(JointState, topic, 1)
        self._twists = self.engine.create_publisher(TwistMessage, f"{SOURCE}/cmd_vel", 1)
        self.engine.create_subscription(Odometry, "odometry/base_raw", self.odometry.append, 10)
        self.expected = self._hear(dialect)
        assert self.node.trigger_configure() == self.node.trigger_activate()
        self.spin_until(lambda: self._publisher.get_subscription_count() > 0)
        self.spin_until(lambda: self._clock.get_subscription_count() > 0)
        self.spin_until(lambda: self._twists.get_subscription_count() > 0)

    def _hear(self, dialect: str) -> int:
        """Subscribes to the commands, and returns the number of messages in a cycle."""
        groups = ((self.drives, self.commands.speeds), (self.steering, self.commands.angles))
        if dialect == "gazebo":
            for (joints, values), name in zip(groups, ("cmd_vel", "cmd_pos"), strict=True):
                for joint, wheel in joints.items():
                    self._subscribe(Float64, f"{joint}/{name}", [wheel], values, "data")
            return len(self.drives) + len(self.steering)
        topics = ("engine/joint_speeds", "engine/joint_angles")
        fields: tuple[str, str] = ("velocity", "position")
        kind: Any = JointState
        if dialect == "ros2_control":
            topics = (
                "drive_velocity_controller/commands",
                "steering_position_controller/commands",
            )
            fields, kind = ("data", "data"), Float64MultiArray
        for (joints, values), topic, field in zip(groups, topics, fields, strict=True):
            if joints:
                self._subscribe(kind, topic, list(joints.values()), values, field)
        return sum(bool(joints) for joints, _ in groups)

    def _subscribe(self, kind: Any, topic: str, wheels: list[int], values: Any, field: str) -> None:
        def take(message: Any) -> None:
            found = getattr(message, field)
            numbers: Sequence[float] = [found] if isinstance(found, float) else found
            for wheel, number in zip(wheels, numbers, strict=True):
                values[wheel] = number
            self.heard += 1

        self.engine.create_subscription(kind, topic, take, 10)

    # -- the cycle -----------------------------------------------------------------------------

    def spin_until(self, condition: Callable[[], bool], longest: float = TIMEOUT) -> bool:
        end = time.monotonic() + longest
        while not condition():
            if time.monotonic() > end:
                assert longest < TIMEOUT, "the driver or the engine is silent"
                return False
            self.executor.spin_once(timeout_sec=0.005)
            self.work()
        return True

    @property
    def robot(self) -> Any:
        return self.node.robot

    @property
    def base(self) -> Any:
        return self.robot.base

    def set_clock(self, now: float) -> None:
        """Publishes the time, and waits until the driver has it."""
        self._clock.publish(Clock(clock=stamp(now)))
        self.spin_until(lambda: abs(self.node.ros_time() - now) < 1e-6)

    def message(self) -> Any:
        """Returns the joint states of all joints of the robot."""
        prefix, states = self.model.prefix, self.states
        message = JointState()
        message.header.stamp = stamp(self.now)
        for joints, positions, speeds in (
            (self.drives, states.positions, states.speeds),
            (self.steering, states.angles, states.angle_rates),
        ):
            for joint, wheel in joints.items():
                message.name.append(prefix + joint)
                message.position.append(float(positions[wheel]))
                message.velocity.append(float(speeds[wheel]))
        return message

    def take(self, message: Any | None = None) -> None:
        """Lets the driver take joint states, without a cycle."""
        taken = self.messages()
        self._publisher.publish(message or self.message())
        self.spin_until(lambda: self.messages() > taken)

    def messages(self) -> int:
        (status,) = self.base.component_statuses(0.0)
        return int(status.values["messages"])

    def cycle(self, message: Any | None = None, period: float | None = None) -> None:
        """Advances the time, publishes joint states and runs the cycle of the driver."""
        self.now += self.robot.period if period is None else period
        self.set_clock(self.now)
        if message is not None:
            message.header.stamp = stamp(self.now)
        self.take(message)
        self.run()

    def run(self) -> None:
        """Runs the cycle if it is due, and waits for its commands."""
        cycles, heard = self.robot.timing.cycles, self.heard
        self.node.run_due()
        if self.robot.timing.cycles > cycles and self.base.has_time:
            self.spin_until(lambda: self.heard >= heard + self.expected)

    def silence(self, seconds: float) -> None:
        """Lets the time of the engine go on without joint states."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now += 0.02
            self.set_clock(self.now)
            self.node.run_due()
            self.follow()

    def send(self, vx: float = 0.0, wz: float = 0.0) -> None:
        """Sends a twist, and waits until the driver has it."""
        received = self.node.inputs.received[SOURCE]
        message = TwistMessage()
        message.linear.x, message.angular.z = vx, wz
        self._twists.publish(message)
        self.spin_until(lambda: self.node.inputs.received[SOURCE] > received)

    def follow(self) -> None:
        """Moves the joints as commanded, for the next cycle."""
        period, states, commands = self.robot.period, self.states, self.commands
        speeds, angles = list(commands.speeds), list(commands.angles)
        positions = [p + s * period for p, s in zip(states.positions, speeds, strict=True)]
        rates = [(a - b) / period for a, b in zip(angles, states.angles, strict=True)]
        self.states = JointStates(self.now, speeds, angles, rates, positions)

    def drive(self, vx: float, cycles: int, wz: float = 0.0) -> None:
        for _ in range(cycles):
            self.send(vx, wz)
            self.cycle()
            self.follow()

    def start(self) -> None:
        """Arms the robot, with a source that has commanded zero."""
        self.drive(0.0, 2)
        self.robot.call("arm")
        self.drive(0.0, 2)

    def fault(self) -> str:
        return str(self.robot.state()["fault"])

    def close(self) -> None:
        self.node.stop_robot()
        self.node.destroy_node()
        self.engine.destroy_node()
        rclpy.shutdown()
