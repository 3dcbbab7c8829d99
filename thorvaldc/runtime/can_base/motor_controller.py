"""The interface of all motor controller drivers, and the table of drivers by protocol."""

from __future__ import annotations

import abc
import enum
import math
from collections.abc import Callable, Iterator
from typing import TypeVar

from thorvaldc.can.frame import CanFrame
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.bus import Bus, Node, ObjectValue
from thorvaldc.model.plugins import PluginFailure, PluginTable
from thorvaldc.model.robot import Actuator, Robot
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

T = TypeVar("T")
MASTER = "master"
"""Name of the base driver among the producers and consumers of frames."""
STANDING = 0.02
"""rad/s.  A slower wheel or steering counts as standing."""
IN_POSITION = 0.01
"""rad.  A steering this close to its target has reached it."""


class Intent(enum.Enum):
    """What the base requests of every controller in a cycle.

    ``OFF``: no torque.  ``HOME``: the steering finds its home position, the wheels stand.
    ``FOLLOW``: wheel speeds and steering angles follow their targets.
    ``QUICK_STOP``: wheels stop as fast as the controller's ramps allow, steering angles are held;
    then no torque.
    """

    OFF = "off"
    HOME = "home"
    FOLLOW = "follow"
    QUICK_STOP = "quick stop"


class Axis:
    """A motor of the base: measurement and target, at the joint (rad, rad/s).

    ``wheel`` is the index in ``Robot.wheels``.  ``time`` (s) is the time of the measurement; NaN
    position and velocity: not measured yet.  ``target`` is a wheel speed or a steering angle.
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

    def update(self, time: float, position: float, velocity: float | None = None) -> None:
        """Stores a measurement; ``velocity`` ``None``: computed from the last two positions."""
        if velocity is None:
            dt = time - self.time
            velocity = (position - self.position) / dt if 0.0 < dt < 1.0 else 0.0
        self.time, self.position, self.velocity = time, position, velocity

    def lose_reference(self) -> None:
        """The controller restarted: the zero of a steering is unknown."""
        self.homed = not self.steering
        self.target = 0.0


class MotorController(abc.ABC):
    """Driver of a node with motors of the base.

    A driver sends nothing itself: it returns the frames to send, and ``CanBase`` sends them in
    the control cycle.  It receives frames by its ``handlers``.

    A package can offer its own driver under the entry-point group ``thorvaldc.motor_controllers``,
    by the name of the node's protocol.  All times in s.
    """

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        self.robot = robot
        self.node = node
        self.codecs = node_codecs(bus, node)
        self.axes = tuple(_axes(robot, node))
        self.handlers: dict[int, Callable[[bytes, float], None]] = {}
        """By COB-ID: called with data and time (s) of the newest frame of each cycle."""
        self.error_code = 0
        """Error code of the last EMCY message; 0: no error."""

    # -- to be implemented -----------------------------------------------------------------------

    @abc.abstractmethod
    def cyclic_frames(self, intent: Intent, now: float) -> list[CanFrame]:
        """Returns the frames that are sent in every control cycle.

        Raises ``ValueError`` where a target is not finite.
        """

    def occasional_frame(self, intent: Intent, now: float) -> CanFrame | None:
        """Returns one more frame to send, or ``None``; a cycle has room for few of them."""
        return None

    @property
    @abc.abstractmethod
    def follows(self) -> bool:
        """``True`` where all motors are powered and follow their targets."""

    @property
    @abc.abstractmethod
    def is_off(self) -> bool:
        """``True`` where no motor has torque, as far as the controller reports it."""

    @property
    @abc.abstractmethod
    def problem(self) -> str:
        """Device errors that must stop the robot; empty: none."""

    @property
    def power_loss(self) -> str:
        """Reason why the power stage is off (a pressed emergency stop); empty: it has power."""
        return ""

    def identity_mismatch(self) -> str | None:
        """Mismatch between the device's identity and the robot file.

        Empty: it matches.  ``None``: the device has not reported its identity yet.
        """
        return ""

    def expected_objects(self) -> Iterator[ObjectValue]:
        """Yields the objects whose values must match before the robot may drive."""
        return iter(())

    @abc.abstractmethod
    def allow_reset(self) -> None:
        """Allows one reset of a device error: the operator has requested it."""

    @property
    def needs_restart(self) -> bool:
        """``True`` where only an NMT reset clears the device error."""
        return False

    # -- common ------------------------------------------------------------------------------------

    @property
    def homed(self) -> bool:
        return all(axis.homed for axis in self.axes)

    @property
    def standing(self) -> bool:
        """``True`` where no wheel is known to turn."""
        return all(not abs(axis.velocity) > STANDING for axis in self.axes if not axis.steering)

    @property
    def in_position(self) -> bool:
        """``True`` where every steering has reached its target and stands."""
        return all(
            abs(axis.position - axis.target) < IN_POSITION and abs(axis.velocity) < STANDING
            for axis in self.axes
            if axis.steering
        )

    def handle_restart(self) -> None:
        """Resets the driver's state after a boot-up message of the node."""
        self.error_code = 0
        for axis in self.axes:
            axis.lose_reference()

    def discard_home(self, now: float) -> None:
        """Marks the steering as not homed, so that the next ``HOME`` finds its home position."""
        for axis in self.axes:
            axis.homed = not axis.steering

    def hold(self) -> None:
        """Sets the targets to the present steering angles and to wheels at rest."""
        for axis in self.axes:
            if axis.steering:
                axis.target = axis.position if math.isfinite(axis.position) else 0.0
            else:
                axis.target = 0.0

    def straighten(self) -> None:
        """Sets the targets to steering straight ahead and to wheels at rest."""
        for axis in self.axes:
            axis.target = 0.0

    def setting_frame(self, name: str, value: float) -> CanFrame:
        """Returns the frame that writes one of the controller's settings, in its units.

        Raises ``ValueError`` where it has no such setting or does not accept the value.
        """
        raise ValueError(f"{self.node.name} has no setting `{name}`")

    def setting_names(self) -> tuple[str, ...]:
        """Returns the names that ``setting_frame`` accepts."""
        return ()

    def set_zero_frame(self) -> CanFrame | None:
        """Returns the frame that makes the present steering angle 0 from the next homing on.

        ``None`` where the controller has no such setting.
        """
        return None

    def axis_of(self, channel: str) -> Axis | None:
        return next((axis for axis in self.axes if axis.channel == channel), None)


def node_codecs(bus: Bus, node: Node) -> dict[str, FrameCodec]:
    """Returns the codecs of the frames that a node sends or that the master sends to it alone.

    The keys are the names of the frames without the name of the node: ``tpdo1``.
    """
    return {
        frame.name.removeprefix(f"{node.name}_"): FrameCodec(frame)
        for frame in bus.frames
        if frame.producer == node.name
        or (frame.producer == MASTER and frame.consumers == (node.name,))
    }


def _axes(robot: Robot, node: Node) -> Iterator[Axis]:
    """Yields an axis for each channel of the node whose motor moves a wheel or a steering."""
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
        "thorvald_roboteq": "thorvaldc.runtime.can_base.roboteq_driver:RoboteqScriptController",
        "thorvald_roboteq_propulsion": (
            "thorvaldc.runtime.can_base.roboteq_driver:RoboteqScriptController"
        ),
    },
)


def controller_class(node: Node) -> type[MotorController]:
    """Returns the motor controller class for a node's protocol.

    Raises ``DiagnosticError`` (``bus-driver-unknown``).
    """
    controller = driver_class(PLUGINS, node)
    if controller is None:
        known = ", ".join(PLUGINS.names())
        raise DiagnosticError(
            "bus-driver-unknown",
            f"there is no driver for the protocol `{node.protocol}` of `{node.name}`",
            node.span,
            hint=f"there are {known}; another package can add one ({PLUGINS.group})",
        )
    return controller


def driver_class(plugins: PluginTable[T], node: Node) -> type[T] | None:
    """Returns the class for a node's protocol, ``None`` where no package offers one.

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
