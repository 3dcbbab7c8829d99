"""The base `topics` in virtual time, without ROS: a stand-in for the node, and ideal joints.

The engine is a simulated robot that keeps its last commands, as Gazebo and ros2_control do.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest import mock

from thorvaldc.model import Robot, wheel_joints
from thorvaldc.model.joint_topics import SPEEDS
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.service_table import ServiceError
from thorvaldc.simulation.physics.sim_base import SimBase

PERIOD = 0.02  # s
SOURCE = "auto_nav"
NAMES = {
    "rclpy": (),
    "rclpy.duration": ("Duration",),
    "rclpy.impl": (),
    "rclpy.impl.implementation_singleton": ("rclpy_implementation",),
    "rclpy.node": ("Node",),
    "rclpy.parameter": ("Parameter",),
    "rclpy.qos": ("QoSProfile", "ReliabilityPolicy"),
    "rcl_interfaces": (),
    "rcl_interfaces.msg": ("FloatingPointRange", "ParameterDescriptor", "SetParametersResult"),
    "sensor_msgs": (),
    "sensor_msgs.msg": ("JointState",),
    "std_msgs": (),
    "std_msgs.msg": ("Float64", "Float64MultiArray"),
    "builtin_interfaces": (),
    "builtin_interfaces.msg": ("Time",),
}
"""Modules of ROS and their classes that the base and the guard use."""
MODULES = ("topic_base", "joint_messages", "joint_guard", "message_wait", "node_parameters")


class _Message(SimpleNamespace):
    def __init__(self, **fields: Any) -> None:
        super().__init__(header=SimpleNamespace(), **fields)


@contextlib.contextmanager
def without_ros(**members: Any) -> Iterator[None]:
    """Lets the base and the guard be imported where no ROS is installed.

    ``members``: stand-ins for other classes of ROS, by name.
    """
    modules = {}
    for name, classes in NAMES.items():
        modules[name] = ModuleType(name)
        for each in classes:
            setattr(modules[name], each, members.get(each, _Message))
    modules["rclpy.qos"].ReliabilityPolicy = SimpleNamespace(BEST_EFFORT=1)  # type: ignore[attr-defined]
    bases = [f"thorvaldc.ros.{name}" for name in MODULES]
    known = {name: sys.modules.pop(name, None) for name in bases}
    try:
        with mock.patch.dict(sys.modules, modules):
            yield
    finally:
        for name, module in known.items():
            sys.modules.pop(name, None)
            if module is not None:
                sys.modules[name] = module


class VirtualTopics:
    """A robot with its driver, and an engine with its joints.

    - ``now``: time (s) of the engine;
    - ``change``: what becomes of the joint states on their way; ``None``: they are lost;
    - ``backwards``: whether the joint states name the joints in the opposite order;
    - ``guarded``: whether a guard hears the heartbeat of the driver;
    - ``offset``: time of ROS minus the time of the engine, which a reset changes.
    """

    def __init__(self, robot: Robot) -> None:
        self.model = robot
        self.now = 1.0
        self.engine = SimBase(robot, self.now)
        n = len(robot.wheels)
        self.commands = JointCommands([0.0] * n, [0.0] * n)
        self.change: Callable[[JointStates], JointStates | None] = lambda states: states
        self.offset = 10.0
        self.twist: Twist | None = Twist(0.0, 0.0, 0.0)
        self.guarded = True
        self.backwards = False
        self._joints = {**wheel_joints(robot)[0], **wheel_joints(robot)[1]}
        with without_ros():
            from thorvaldc.ros.topic_base import robot_behind_topics

            self.driven = robot_behind_topics(self, robot, "joint_states")
        self.base: Any = self.driven.base

    # -- the node of the base --------------------------------------------------------------------

    def create_publisher(self, kind: object, topic: str, depth: int) -> Any:
        return SimpleNamespace(
            publish=lambda message: self._hear(topic, message),
            get_subscription_count=lambda: int(self.guarded),
            topic_name=f"/{topic}",
        )

    def create_subscription(self, kind: object, topic: str, take: object, qos: object) -> Any:
        return SimpleNamespace(topic_name=f"/{topic}")

    def get_clock(self) -> Any:
        nanoseconds = round((self.now + self.offset) * 1e9)
        stamp = SimpleNamespace(nanoseconds=nanoseconds, to_msg=lambda: None)
        return SimpleNamespace(now=lambda: stamp)

    def _hear(self, topic: str, message: Any) -> None:
        if not hasattr(message, "name"):  # a sign of life
            return
        values = self.commands.speeds if topic == SPEEDS else self.commands.angles
        field = message.velocity if topic == SPEEDS else message.position
        for name, value in zip(message.name, field, strict=True):
            values[self._joints[name.removeprefix(self.model.prefix)]] = value  # type: ignore[index]
        commands = JointCommands(list(self.commands.speeds), list(self.commands.angles))
        self.engine.write(commands, self.now)

    # -- the cycle -------------------------------------------------------------------------------

    def step(self, period: float = PERIOD) -> None:
        """Lets the engine run for a period, and the driver do what is due then."""
        self.now += period
        states = self.change(self.engine.read(self.now))
        if states is not None:
            self.base.take(self._message(states))
        if self.driven.wait() <= 0.0:
            if self.twist is not None:
                with contextlib.suppress(ServiceError):  # zero comes first
                    self.driven.call("twist", source=SOURCE, **self.twist._asdict())
            self.driven.run_due_cycle()

    def _message(self, states: JointStates) -> Any:
        drives, steering = wheel_joints(self.model)
        positions = states.positions or ()
        rows = [(j, positions[i], states.speeds[i]) for j, i in drives.items()]
        rows += [(j, states.angles[i], states.angle_rates[i]) for j, i in steering.items()]
        names, places, speeds = zip(*rows[:: -1 if self.backwards else 1], strict=True)
        nanoseconds = round((states.time + self.offset) * 1e9)
        stamp = SimpleNamespace(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return SimpleNamespace(
            header=SimpleNamespace(stamp=stamp),
            name=[self.model.prefix + name for name in names],
            position=list(places),
            velocity=list(speeds),
        )

    def drive(self, twist: Twist, seconds: float) -> None:
        """Arms the robot if it is not, and drives."""
        if not self.driven.armed:
            self.twist = Twist(0.0, 0.0, 0.0)
            for _ in range(5):
                self.step()
            self.driven.call("arm")
        self.twist = twist
        for _ in range(round(seconds / PERIOD)):
            self.step()

    # -- the true wheels -------------------------------------------------------------------------

    def wheels(self) -> list[tuple[float, float]]:
        """Returns the true path (m) and speed (m/s) of each driven wheel at the ground."""
        states = self.engine.read(self.now)
        positions = states.positions or ()
        return [
            (positions[i] * w.radius, abs(states.speeds[i]) * w.radius)
            for i, w in enumerate(self.model.wheels)
            if w.driven
        ]

    @property
    def commanded(self) -> list[float]:
        """Speed (m/s) at the ground that the engine was commanded, of each driven wheel."""
        return [
            abs(v) * w.radius
            for v, w in zip(self.commands.speeds, self.model.wheels, strict=True)
            if w.driven
        ]
