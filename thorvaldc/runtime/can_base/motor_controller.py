"""Motor controllers: what the base wants of one, whatever it is; and which there are."""

from __future__ import annotations

import abc
import enum
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.bus import Bus, FrameDefinition, Node, ObjectValue
from thorvaldc.model.plugins import PluginFailure, PluginTable
from thorvaldc.model.robot import Actuator, Robot
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

T = TypeVar("T")
MASTER = "master"
STANDING = 0.02
"""rad/s of a wheel below which it stands."""
STRAIGHT = 0.01
"""rad of a steering from its target within which it has come to it."""


class Intent(enum.Enum):
    """What is wanted of every controller at once.

    ``OFF``: no torque.  ``HOME``: the steering finds its home, the wheels stand.
    ``FOLLOW``: speeds and angles as told; before the first it stands as it is.
    ``QUICK_STOP``: to rest as fast as its ramps allow, steering held; then no torque.
    """

    OFF = "off"
    HOME = "home"
    FOLLOW = "follow"
    QUICK_STOP = "quick stop"


class Message(NamedTuple):
    """A frame to send."""

    cob_id: int
    data: bytes


class Axis:
    """A motor of the base: what it does and what it shall do, at the joint (rad, rad/s).

    ``wheel`` is its place in ``Robot.wheels``.  ``time`` (s) is when it was measured;
    ``target`` a speed, of a steering an angle.
    """

    def __init__(self, actuator: Actuator, wheel: int, channel: str) -> None:
        self.actuator = actuator
        self.joint = actuator.joint
        self.wheel = wheel
        self.channel = channel
        self.steering = actuator.role == "steering"
        self.time = -math.inf
        self.position = math.nan
        self.velocity = math.nan
        self.target = 0.0
        self.homed = not self.steering

    def measured(self, time: float, position: float, velocity: float | None = None) -> None:
        """A position; its speed where it is measured too, else from the position before."""
        if velocity is None:
            dt = time - self.time
            velocity = (position - self.position) / dt if 0.0 < dt < 1.0 else 0.0
        self.time, self.position, self.velocity = time, position, velocity

    def forget(self) -> None:
        """It has been without power: where it stands is not known."""
        self.homed = not self.steering
        self.target = 0.0


class MotorController(abc.ABC):
    """A node with motors of the base.  It sends nothing itself: it says what to send.

    A class of another package is found by the entry point group
    ``thorvaldc.motor_controllers``, named after the node's protocol.  All times in s.
    """

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        self.robot = robot
        self.node = node
        self.codecs = {
            frame.name.removeprefix(f"{node.name}_"): FrameCodec(frame)
            for frame in frames_of(bus, node)
        }
        self.axes = tuple(_axes(robot, node))
        self.handlers: dict[int, Callable[[bytes, float], None]] = {}
        """Called with data and time of each frame of that identifier."""
        self.error_code = 0
        """Of the last emergency; 0: it said that all is well again."""

    # -- to be said by each kind -----------------------------------------------------------------

    @abc.abstractmethod
    def cyclic(self, intent: Intent, now: float) -> list[Message]:
        """What is sent in every control cycle.

        Raises ``ValueError`` where a target is not finite.
        """

    def sporadic(self, intent: Intent, now: float) -> Message | None:
        """One frame more, where there is something to tell; there is room for few of them."""
        return None

    @property
    @abc.abstractmethod
    def follows(self) -> bool:
        """Whether its motors are powered and do as told."""

    @property
    @abc.abstractmethod
    def is_off(self) -> bool:
        """Whether its motors are without torque, as far as it tells."""

    @property
    @abc.abstractmethod
    def problem(self) -> str:
        """What it says is wrong with it; empty: nothing."""

    @property
    def unpowered(self) -> str:
        """Why its power stage has no power (an emergency stop was pressed); empty: it has."""
        return ""

    def identity(self) -> str | None:
        """What is wrong with who it is: empty nothing, ``None`` not known yet."""
        return ""

    def objects(self) -> Iterator[ObjectValue]:
        """Entries of its object dictionary that must have their values before it may drive."""
        return iter(())

    @abc.abstractmethod
    def allow_reset(self) -> None:
        """The operator has asked for it: a fault may be reset once."""

    @property
    def needs_restart(self) -> bool:
        """Whether only an NMT reset gets it out of the fault that it is in."""
        return False

    # -- common ------------------------------------------------------------------------------------

    @property
    def homed(self) -> bool:
        return all(axis.homed for axis in self.axes)

    @property
    def standing(self) -> bool:
        """Whether no wheel of it turns, as far as is known."""
        return all(not abs(axis.velocity) > STANDING for axis in self.axes if not axis.steering)

    def restarted(self) -> None:
        """It has said that it comes from a restart."""
        self.error_code = 0
        for axis in self.axes:
            axis.forget()

    def home_again(self, now: float) -> None:
        """Take the steering's zero for lost."""
        for axis in self.axes:
            axis.homed = not axis.steering

    def hold(self) -> None:
        """Want it to stand as it is, whatever was wanted before."""
        for axis in self.axes:
            if axis.steering:
                axis.target = axis.position if math.isfinite(axis.position) else 0.0
            else:
                axis.target = 0.0

    def setting(self, name: str, value: float) -> Message:
        """The frame that sets a value of the controller's own.

        Raises ``ValueError`` where it has no such setting, or not that value.
        """
        raise ValueError(f"{self.node.name} has no setting `{name}`")

    def settings(self) -> tuple[str, ...]:
        """The names that ``setting`` takes."""
        return ()

    def straighten(self) -> None:
        """Want the steering straight ahead, and the wheels at rest."""
        for axis in self.axes:
            axis.target = 0.0

    @property
    def arrived(self) -> bool:
        """Whether every steering is where it shall be, and stays there."""
        return all(
            abs(axis.position - axis.target) < STRAIGHT and abs(axis.velocity) < STANDING
            for axis in self.axes
            if axis.steering
        )

    def zero_here(self) -> Message | None:
        """The frame that makes the steering's present angle 0 from the next homing on.

        ``None`` where there is no such frame.
        """
        return None

    def axis_of(self, channel: str) -> Axis | None:
        return next((axis for axis in self.axes if axis.channel == channel), None)


def frames_of(bus: Bus, node: Node) -> list[FrameDefinition]:
    """The frames that a node sends, and those that are for it alone."""
    return [
        frame
        for frame in bus.frames
        if frame.producer == node.name
        or (frame.producer == MASTER and frame.consumers == (node.name,))
    ]


def _axes(robot: Robot, node: Node) -> Iterator[Axis]:
    wheels: dict[str, int] = {}
    for i, wheel in enumerate(robot.wheels):
        wheels[wheel.spin_joint] = i
        if wheel.steering_joint is not None:
            wheels[wheel.steering_joint] = i
    actuators = {actuator.name: actuator for actuator in robot.actuators}
    for channel in node.channels:
        if channel.actuator is None or channel.actuator not in actuators:
            continue
        actuator = actuators[channel.actuator]
        if actuator.joint in wheels:
            yield Axis(actuator, wheels[actuator.joint], channel.name)


PLUGINS: PluginTable[MotorController] = PluginTable(
    "thorvaldc.motor_controllers",
    MotorController,
    {
        "cia402": "thorvaldc.runtime.can_base.cia402_driver:Cia402Controller",
        "thorvald_roboteq": "thorvaldc.runtime.can_base.roboteq_driver:RoboteqScript",
        "thorvald_roboteq_propulsion": "thorvaldc.runtime.can_base.roboteq_driver:RoboteqScript",
    },
)


def controller_class(node: Node) -> type[MotorController]:
    """Return the motor controller class for a node's protocol.

    Raises ``DiagnosticError`` (``bus-driver-unknown``).
    """
    controller = driver_class(PLUGINS, node)
    if controller is None:
        known = ", ".join(PLUGINS.names())
        raise DiagnosticError(
            "bus-driver-unknown",
            f"no driver knows how to talk to `{node.name}`: its protocol is `{node.protocol}`",
            node.span,
            hint=f"there are {known}; a package of your own may add one ({PLUGINS.group})",
        )
    return controller


def driver_class(plugins: PluginTable[T], node: Node) -> type[T] | None:
    """Return the class for a node's protocol, ``None`` where no package offers one.

    Raises ``DiagnosticError`` (``bus-driver-unknown``) where the offered class cannot be used.
    """
    driver = plugins.load(node.protocol)
    if not isinstance(driver, PluginFailure):
        return driver
    if driver.unknown:
        return None
    raise DiagnosticError(
        "bus-driver-unknown", f"the driver for `{node.protocol}` {driver.reason}", node.span
    )
