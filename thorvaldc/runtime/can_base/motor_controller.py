"""Base class of all motor controller drivers, and the table of drivers by protocol."""

from __future__ import annotations

import abc
import enum
import math
from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar, Final, TypeVar

from thorvaldc.can.frame import CanFrame
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Bus, Node, ObjectValue, Robot
from thorvaldc.model.bus import MASTER
from thorvaldc.model.bus_timing import required_objects
from thorvaldc.model.plugins import PluginFailure, PluginTable
from thorvaldc.runtime.can_base.signal_codec import FrameCodec
from thorvaldc.runtime.motion_supervision import STANDING, Axis, FollowLimits
from thorvaldc.runtime.mypyc_marks import mypyc_attr

T = TypeVar("T")
FRESH: Final = 0.2
"""Age (s) up to which a report tells the present motion of a wheel."""
IN_POSITION: Final = 0.01
"""Largest deviation (rad) of a steering joint that has reached its target angle."""


class Intent(enum.Enum):
    """Request of the base to all motor controllers in a control cycle.

    - ``OFF``: the motors have no torque;
    - ``HOME``: the steering motors search their home positions and the wheels stand;
    - ``FOLLOW``: wheel speeds and steering angles follow their targets;
    - ``QUICK_STOP``: the wheels stop with the steepest ramp of the motor controller and the
      steering angles are held.  The driver takes no torque from the motors, neither during the
      stop nor at rest; the motor controller itself may do so after the stop.
    """

    OFF = "off"
    HOME = "home"
    FOLLOW = "follow"
    QUICK_STOP = "quick stop"


@mypyc_attr(allow_interpreted_subclasses=True)
class MotorController(abc.ABC):
    """Base class of the driver of a motor controller on the CAN bus.

    A motor controller driver never sends CAN frames.  The methods of a motor controller driver
    return the CAN frames to send, and ``CanBase`` sends the CAN frames in the control cycle.
    Received CAN frames are passed to the functions in the dictionary ``handlers``.  All times of
    the motor controller driver are in seconds.

    A Python package can add a motor controller driver with the entry-point group
    ``thorvaldc.motor_controllers``.  The name of the Python entry point is the protocol of the
    motor controller node.
    """

    follow_limits: ClassVar[FollowLimits] = FollowLimits()
    """Limits of the deviation of a motor from its target.  Only stricter limits than those of all
    drivers count."""
    powers_single_motors: ClassVar[bool] = False
    """``True`` if a motor gets no torque whose axis is not ``powered``, while another motor of the
    controller follows its target.  The driver of a single motor needs nothing for it, see
    ``intent_of``."""
    checks_watchdog: ClassVar[bool] = False
    """``True`` if the driver reads the watchdog of a device that is no CANopen device again and
    again, and reports a problem within 3 s after it was switched off."""

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        self.robot = robot
        self.bus = bus
        self.node = node
        self.codecs = node_codecs(bus, node)
        self.axes = tuple(_axes(robot, node))
        for axis in self.axes:
            axis.limits = axis.limits.stricter(self.follow_limits)
        self.handlers: dict[int, Callable[[bytes, float], None]] = {}
        """Handlers by key of a frame; called once in a cycle with its newest data and time (s)."""
        self.error_code = 0
        """Error code of the last EMCY message; 0: no error."""
        self.disobeyed = False
        """``True`` if a motor was seen not to stop when it should, since the last start-up."""
        self.warning = ""
        """Motion that stops nothing, but that the operator should know, or an empty text."""

    # -- to be implemented -----------------------------------------------------------------------

    @abc.abstractmethod
    def cyclic_frames(self, intent: Intent, now: float) -> list[CanFrame]:
        """Returns the CAN frames that are sent in every control cycle.

        Raises ``ValueError`` if a target speed or a target angle is not finite.
        """

    def occasional_frame(self, intent: Intent, now: float) -> CanFrame | None:
        """Returns a CAN frame that is not sent in every control cycle, or ``None``.

        Only a few occasional CAN frames can be sent on each bus in a control cycle.
        """
        return None

    def query_frame(self, now: float) -> CanFrame | None:
        """Returns a CAN frame that asks the device for its identity or a setting, or ``None``.

        The CAN frame must not change anything in the device, because it is also sent before the
        device was compared with the robot file.  The driver of a CANopen device needs no queries:
        ``CanBase`` reads the ``expected_objects``.
        """
        return None

    @property
    @abc.abstractmethod
    def follows(self) -> bool:
        """``True`` if all motors are powered and follow the target speeds and target angles."""

    @property
    @abc.abstractmethod
    def is_off(self) -> bool:
        """``True`` if no motor has torque, as far as the motor controller reports the torque."""

    @property
    @abc.abstractmethod
    def problem(self) -> str:
        """Device errors of the motor controller that must stop the robot, or an empty text."""

    @property
    def power_loss(self) -> str:
        """Reason why the power stage of the motor controller is off, or an empty text if it is on.

        The most common reason for a power stage that is off is a pressed emergency stop button.
        """
        return ""

    @property
    def watchdog_acted(self) -> bool:
        """``True`` if the drive reports that its own watchdog has stopped the motors."""
        return self.error_code & 0xFF00 == 0x8100  # communication, see CiA 301

    def identity_mismatch(self) -> str | None:
        """Returns a message if the identity of the device does not match the robot file.

        Returns an empty text if the identity of the device matches the robot file.  Returns
        ``None`` if the device has not reported its identity yet.
        """
        return ""

    def expected_objects(self) -> Iterator[ObjectValue]:
        """Yields the object dictionary entries whose values in the device must match the robot
        file.

        The base driver compares them at the start-up, and reads them again and again.  A driver
        that changes some of them at run time leaves these out.
        """
        return required_objects(self.bus, self.node)

    def shortest_periods(self) -> Mapping[str, float]:
        """Returns the shortest period (s) of each report that the driver accelerates, by frame
        name."""
        return {}

    @abc.abstractmethod
    def allow_reset(self) -> None:
        """Allows one reset of a device error of the motor controller, after a request of the
        operator."""

    @property
    def needs_restart(self) -> bool:
        """``True`` if the device error can be cleared only by an NMT reset of the node."""
        return self.disobeyed

    # -- common ------------------------------------------------------------------------------------

    @property
    def powered(self) -> bool:
        """``False`` if no motor may have torque."""
        return not self.axes or any(axis.powered for axis in self.axes)

    def intent_of(self, intent: Intent) -> Intent:
        """Returns the ``Intent`` for this motor controller, from that for all of them."""
        return intent if self.powered else Intent.OFF

    def note_intent(self, intent: Intent) -> None:
        """Notes which motors follow their targets with this ``Intent`` of the last cycle."""
        homing = intent is Intent.HOME
        follows = self.follows if intent is Intent.FOLLOW else homing and not self.is_off
        for axis in self.axes:
            axis.follows = follows and axis.powered and not (homing and axis.steering)

    @property
    def homed(self) -> bool:
        return all(axis.homed for axis in self.axes if axis.powered)

    @property
    def standing(self) -> bool:
        """``True`` if no wheel turns faster than ``STANDING``.

        Wheels without a measured speed are ignored.
        """
        return all(not abs(axis.velocity) > STANDING for axis in self.axes if not axis.steering)

    def turns(self, now: float) -> bool:
        """Checks whether a report that is not older than ``FRESH`` says that a wheel turns."""
        return any(
            abs(axis.velocity) > STANDING and now - axis.time < FRESH
            for axis in self.axes
            if not axis.steering
        )

    @property
    def in_position(self) -> bool:
        """``True`` if every steering joint has reached its target angle and does not move."""
        return all(
            abs(axis.position - axis.target) < IN_POSITION and abs(axis.velocity) < STANDING
            for axis in self.axes
            if axis.steering and axis.powered
        )

    def handle_restart(self) -> None:
        """Resets the state of the motor controller driver after a boot-up message of the node."""
        self.error_code = 0
        for axis in self.axes:
            axis.lose_reference()

    def discard_home(self, now: float) -> None:
        """Marks all steering motors as not homed, so that the next ``HOME`` starts a homing."""
        for axis in self.axes:
            axis.homed = not axis.steering

    def encoder_jump(self, now: float) -> str:
        """Returns a message if the encoder of a steering joint has jumped, or an empty text.

        The zero position of the joint is then unknown, and the next start-up homes the joint again.
        """
        for axis in self.axes:
            if axis.jump:
                text = f"the encoder of {axis.channel} jumped by {math.degrees(axis.jump):.0f} deg"
                axis.jump = 0.0
                self.discard_home(now)
                return text
        return ""

    def stand(self) -> None:
        """Sets the target speeds to 0."""
        for axis in self.axes:
            if not axis.steering:
                axis.target = 0.0

    def hold(self) -> None:
        """Sets the target angles to the measured steering angles and the target speeds to 0."""
        for axis in self.axes:
            axis.hold()

    def straighten(self) -> None:
        """Sets all target steering angles and all target wheel speeds to 0."""
        for axis in self.axes:
            axis.target = 0.0

    def setting_frame(self, name: str, value: float) -> CanFrame:
        """Returns the CAN frame that changes a setting of the motor controller.

        ``value``: new value of the setting, in the unit that the motor controller uses.  Raises
        ``ValueError`` if the motor controller has no setting ``name`` or does not accept the value.
        """
        raise ValueError(f"{self.node.name} has no setting `{name}`")

    def setting_names(self) -> tuple[str, ...]:
        """Returns the names of the settings that ``setting_frame`` can change."""
        return ()

    def set_zero_frame(self) -> CanFrame | None:
        """Returns the CAN frame that defines the present steering angle as zero.

        The new zero of the steering angle is valid after the next homing.  Returns ``None`` if the
        motor controller cannot change the zero of the steering angle.
        """
        return None

    def axis_of(self, channel: str) -> Axis | None:
        return next((axis for axis in self.axes if axis.channel == channel), None)


def node_codecs(bus: Bus, node: Node) -> dict[str, FrameCodec]:
    """Returns the codecs of the CAN frames that a node sends, and of the CAN frames that are sent
    to this node only.

    The codecs are returned by CAN frame name without the name of the node, for example ``tpdo1``.
    """
    return {
        frame.name.removeprefix(f"{node.name}_"): FrameCodec(frame)
        for frame in bus.frames
        if frame.producer == node.name
        or (frame.producer == MASTER and frame.consumers == (node.name,))
    }


def _axes(robot: Robot, node: Node) -> Iterator[Axis]:
    """Yields an ``Axis`` for each channel of a motor controller that drives or steers a wheel."""
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


PLUGINS: Final[PluginTable[MotorController]] = PluginTable(
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
    """Returns the class of the driver of a motor controller; raises as ``required_driver``."""
    return required_driver(PLUGINS, node)


def required_driver(plugins: PluginTable[T], node: Node) -> type[T]:
    """Returns the driver class for the protocol of a node.

    Raises ``DiagnosticError`` (``bus-driver-unknown``) if no driver supports the protocol, or if
    the driver class cannot be used.
    """
    driver = driver_class(plugins, node)
    if driver is None:
        known = ", ".join(plugins.names())
        raise DiagnosticError(
            "bus-driver-unknown",
            f"there is no driver for the protocol `{node.protocol}` of `{node.name}`",
            node.span,
            hint=f"there are {known}; another package can add one ({plugins.group})",
        )
    return driver


def driver_class(plugins: PluginTable[T], node: Node) -> type[T] | None:
    """Returns the driver class for the protocol of a node, or ``None`` if no driver supports the
    protocol.

    Raises ``DiagnosticError`` (``bus-driver-unknown``) if the driver class cannot be used.
    """
    driver = plugins.load(node.protocol)
    if not isinstance(driver, PluginFailure):
        return driver
    if driver.unknown:
        return None
    raise DiagnosticError(
        "bus-driver-unknown", f"the driver for `{node.protocol}` {driver.reason}", node.span
    )
