"""The base class of all simulated devices on a CAN bus, and the data from which they are made."""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can import lss
from thorvaldc.can.canopen import HEARTBEAT
from thorvaldc.can.frame import NANOSECONDS, CanFrame, to_ns
from thorvaldc.model import Actuator, Bus, Channel, FrameDefinition, Node, Robot
from thorvaldc.model.bus import EXTENDED, MASTER
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus.object_dictionary import parameter_name
from thorvaldc.simulation.bus.simulated_motors import Encoder, IdealMotor, MotorModel
from thorvaldc.simulation.bus.timeline import Action, Event
from thorvaldc.simulation.bus.wire import CanController, Wire

LATENCY = 100e-6
"""Shortest reaction time (s) of a device to a frame.  A random time of up to 50 % is added."""
WRITE_TIME = 20e-3
"""Duration (s) of a write to non-volatile memory."""
BITRATE = "bitrate"
"""Key of the bitrate (bit/s) in non-volatile memory."""


class SimulatedDevice:
    """A simulated device on a CAN bus.

    A subclass implements the method ``start``, which adds frame handlers and starts timers.
    ``handlers`` has a function for each key (``CanFrame.key``) that the device receives, and
    ``remote_handlers`` one for each key of a remote frame.  The device calls the frame
    handlers with a short random delay, in the order of the received frames.
    The seed and the name of the specification determine the random delays of the device.

    A device is inactive before ``power_on``.  A loss of power stops all timers and clears the send
    queue and the volatile state of the device.  The mapping ``nonvolatile`` is the non-volatile
    memory of the device, and what the function ``hardware`` returns.  If ``muted`` is true, the
    device receives and acknowledges CAN frames, but does not send CAN frames.

    Another package can provide a device class by an entry point in the group
    ``thorvaldc.simulated_devices``.  The name of the Python entry point is the protocol of the CAN
    node.
    """

    def __init__(
        self, specification: DeviceSpecification, memory: Mapping[str, Any] | None = None
    ) -> None:
        """Creates the device of a node without power.

        ``memory`` is what the non-volatile memory contains, unless the specification replaces it.
        """
        self.specification = specification
        self.name, self.wire = specification.name, specification.wire
        self.timeline = self.wire.timeline
        self.random = random.Random(f"{specification.seed}:{self.name}")
        self.factory_bitrate = specification.bus.bitrate
        self.nonvolatile: dict[str, Any] = {
            BITRATE: self.factory_bitrate,
            **(memory or {}),
            **specification.nonvolatile,
        }
        self.write_time = WRITE_TIME
        self.torn_writes = False
        """True if a loss of power during a write destroys the values of the write."""
        self.muted = False
        self.powered = False
        self.handlers: dict[int, Callable[[CanFrame], None]] = {}
        self.remote_handlers: dict[int, Callable[[CanFrame], None]] = {}
        self.controller = CanController(self.wire, self.name, self.factory_bitrate)
        self.controller.on_frame = self._schedule_handler
        self.wire.attach(self.controller)
        self._life = 0
        """Number of starts of the device.  Timers from before the last start have no effect."""
        self._handled_until = 0
        self._writing: dict[str, Any] = {}

    # -- power ------------------------------------------------------------------------------

    def power_on(self) -> None:
        if self.powered:
            return
        self.powered = True
        # A loss of power during a write may have destroyed the stored bitrate.
        self.controller.bitrate = self.nonvolatile.get(BITRATE, self.factory_bitrate)
        self.controller.switch_on()
        self.start()

    def power_off(self) -> None:
        """Switches the power of the device off.

        A write to non-volatile memory that is in progress is lost.  If ``torn_writes`` is true, the
        stored values that the interrupted write changes are deleted.
        """
        if not self.powered:
            return
        self.powered = False
        self._life += 1
        if self.torn_writes:
            for key in self._writing:
                self.nonvolatile.pop(key, None)
        self._writing = {}
        self.handlers, self.remote_handlers = {}, {}
        self.controller.switch_off()
        self.stop()

    def start(self) -> None:
        """Adds the frame handlers and starts the timers of the device.

        The base class calls ``start`` after power-on.
        """

    def stop(self) -> None:
        """Switches the motors and outputs of the device off.

        The base class calls ``stop`` after a loss of power.
        """

    def channel_motor(self, index: int) -> tuple[Encoder | None, MotorModel | None]:
        """Returns the encoder and the motor of a channel.

        An injected fault freezes the encoder or blocks the motor.
        """
        return None, None

    def change_node_id(self, node_id: int) -> None:
        """Changes the node id of the device.

        The method replaces the configuration tool of the manufacturer.  Raises ``ValueError`` if
        the device has no node id.
        """
        raise ValueError(f"{self.name} has no id")

    def set_charge(self, charge: float) -> float:
        """Sets the state of charge of a battery, 0 to 1, and returns the previous state of charge.

        Raises ``ValueError`` if the device is not a battery.
        """
        raise ValueError(f"{self.name} is not a battery")

    def lose_watchdog(self) -> None:
        """Switches off the watchdog that stops the motors when the base driver falls silent.

        The watchdog works again after a reset of the device.  Raises ``ValueError`` if the device
        has no watchdog.
        """
        raise ValueError(f"{self.name} has no watchdog")

    def overwrite_object(self, index: int, subindex: int, value: int) -> int | None:
        """Changes an object of the object dictionary, as a service tool at another interface does.

        Returns the previous value, or ``None`` if the device refuses an object or a value that it
        cannot have.  The stored value applies again after a reset of the device.  Raises
        ``ValueError`` if the device has no object dictionary.
        """
        raise ValueError(f"{self.name} has no object dictionary")

    def change_bitrate(self, bitrate: int) -> None:
        """Changes the bitrate (bit/s) of the CAN controller until the next power-on."""
        self.controller.bitrate = bitrate
        self.controller.restart()

    # -- time -------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """Simulated time (s)."""
        return self.timeline.now / NANOSECONDS

    def after(self, delay: float, action: Action) -> Event:
        """Calls ``action`` after ``delay`` s.

        A loss of power cancels the call of ``action``.
        """
        life = self._life

        def act() -> None:
            if self._life == life:
                action()

        return self.timeline.after(to_ns(delay), act)

    def every(self, period: Callable[[], float], action: Action, first: float = 0.0) -> None:
        """Calls ``action`` periodically, for the first time after ``first`` s.

        The function ``period`` returns the time (s) to the next call of ``action``.  If ``period``
        returns 0 or less, ``action`` is not called, and ``period`` is called again after 0.1 s.  A
        loss of power ends the periodic calls.
        """

        def repeat() -> None:
            if period() > 0.0:
                action()
            following = period()
            self.after(following if following > 0.0 else 0.1, repeat)

        self.after(first, repeat)

    # -- frames -----------------------------------------------------------------------------

    def send(self, key: int, data: bytes) -> None:
        """Sends the CAN frame with a key, which is the identifier of a standard frame.

        The CAN frame is dropped if the device is muted, if the send queue is full, or if the CAN
        controller is in bus-off.
        """
        if not self.muted:
            self.controller.send(CanFrame(key & ~EXTENDED, data, key >= EXTENDED))

    def _schedule_handler(self, frame: CanFrame) -> None:
        if frame.key not in self._handlers_of(frame):
            return
        life = self._life
        delay = LATENCY * (1.0 + self.random.random() / 2.0)
        self._handled_until = max(self.timeline.now + to_ns(delay), self._handled_until)

        def handle() -> None:
            handler = self._handlers_of(frame).get(frame.key)
            if handler is not None and self._life == life:
                handler(frame)

        self.timeline.at(self._handled_until, handle)

    def _handlers_of(self, frame: CanFrame) -> dict[int, Callable[[CanFrame], None]]:
        return self.remote_handlers if frame.remote else self.handlers

    # -- non-volatile memory -------------------------------------------------------------------

    def store(self, changes: Mapping[str, Any], on_stored: Action | None = None) -> None:
        """Writes ``changes`` to the non-volatile memory of the device.

        After the duration of the write, ``nonvolatile`` is updated and ``on_stored`` is called.
        """
        self._writing = {**self._writing, **changes}
        values = dict(changes)

        def finish() -> None:
            self.nonvolatile.update(values)
            for key in values:
                self._writing.pop(key, None)
            if on_stored is not None:
                on_stored()

        self.after(self.write_time, finish)


# -- data of a node --------------------------------------------------------------------------------


@dataclass
class DeviceSpecification:
    """The data of a CAN node from which a ``SimulatedDevice`` is created.

    * ``robot``: robot of the node.
    * ``bus``: bus of the node.
    * ``node``: node in the model.
    * ``wire``: simulated bus line.
    * ``motor``: function that returns the motor model of an actuator.
    * ``name``: name of the device, which differs from the name of the node only for a clone.
    * ``seed``: seed of the random numbers of the device.
    * ``delivered``: true for a device in the factory state.  A device in the factory state has no
      node id and no parameters if a master can write the node id and the parameters over the CAN
      bus.
    * ``nonvolatile``: what ``hardware`` returns for the device, and values that replace values in
      its non-volatile memory, such as ``node_id`` or ``bitrate``.
    * ``quirks``: quirks of the device, if it is a CANopen device.
    """

    robot: Robot
    bus: Bus
    node: Node
    wire: Wire
    motor: Callable[[Actuator], MotorModel]
    name: str = ""
    seed: int = 0
    delivered: bool = False
    nonvolatile: Mapping[str, Any] = field(default_factory=dict)
    quirks: frozenset[Quirk] = frozenset()

    @property
    def sent(self) -> list[FrameDefinition]:
        """Definitions of the CAN frames that the node sends."""
        return [frame for frame in self.bus.frames if frame.producer == self.node.name]

    @property
    def received(self) -> list[FrameDefinition]:
        """Definitions of the CAN frames that the master sends only to the node."""
        return [
            frame
            for frame in self.bus.frames
            if frame.producer == MASTER and frame.consumers == (self.node.name,)
        ]

    def period(self, key: int, default: float) -> float:
        """Returns the period (s) of the CAN frame with the key ``key`` that the node sends.

        Returns ``default`` if the node does not send the CAN frame periodically.
        """
        periods = (frame.period for frame in self.sent if frame.key == key)
        return next((period for period in periods if period is not None), default)

    @property
    def heartbeat_period(self) -> float:
        """Period of the heartbeat (s), or 0 if the node sends no heartbeat."""
        return self.period(HEARTBEAT + self.node.id, 0.0)

    def property(self, name: str) -> Any:
        """Returns a property of the robot module with the node, or ``None`` if unknown."""
        return dict(self.node.properties).get(name)

    def channels(self) -> list[tuple[Channel, Actuator | None, MotorModel]]:
        """Returns each channel of the motor controller with its actuator and motor."""
        actuators = [(c, self.actuator(c.name)) for c in self.node.channels]
        return [(c, actuator, self.motor_of(actuator)) for c, actuator in actuators]

    def actuator(self, channel: str) -> Actuator | None:
        """Returns the actuator at a channel of the motor controller, or ``None``."""
        name = next(c.actuator for c in self.node.channels if c.name == channel)
        return next((actuator for actuator in self.robot.actuators if actuator.name == name), None)

    def motor_of(self, actuator: Actuator | None) -> MotorModel:
        """Returns the motor model of an actuator.

        If ``actuator`` is ``None``, the function returns a motor without a load.
        """
        return IdealMotor(1.0, 1.0) if actuator is None else self.motor(actuator)


# -- identity and wiring of a device ---------------------------------------------------------------

SERIAL, MOTORS = "serial", "motors"
"""Keys of the serial number, and of the motors by channel, in ``SimulatedDevice.nonvolatile``."""


def hardware(robot: Robot, node: Node, name: str) -> dict[str, Any]:
    """Returns the serial number and the motors of a new device for a node.

    They are those of the robot file.  The device keeps them if the file changes later.  If the file
    has no serial number, that of a device with LSS depends only on the names.  A clone, whose
    ``name`` is not that of the node, has a serial number of its own.  A device without LSS and
    without a product code cannot report a serial number.
    """
    motors = {c.name: c.actuator for c in node.channels if c.actuator is not None}
    identity: dict[str, Any] = {MOTORS: motors} if motors else {}
    number = node.serial_number
    if node.lss or (number is not None and node.product_code is not None):
        if number is None or name != node.name:
            number = zlib.crc32(f"{robot.name}/{name}".encode())
        identity[SERIAL] = f"{number:#x}"
    return identity


# -- data of a CANopen device ----------------------------------------------------------------------

NODE_ID, PARAMETERS = "node_id", "parameters"
"""Keys of the values in non-volatile memory."""


def commissioned_memory(specification: DeviceSpecification) -> dict[str, Any]:
    """Returns the contents of the non-volatile memory of a commissioned node.

    The memory contains the node id and the parameter values of the CAN map.  A device in the
    factory state has no parameter values.  A device in the factory state with LSS also has no node
    id.
    """
    node = specification.node
    without_id = specification.delivered and node.lss
    parameters = {
        parameter_name(entry.index, entry.subindex): entry.value
        for entry in node.objects
        if entry.access == "rw" and entry.value is not None
    }
    return {
        NODE_ID: lss.UNCONFIGURED if without_id else node.id,
        PARAMETERS: {} if specification.delivered else parameters,
        **specification.nonvolatile,
    }
