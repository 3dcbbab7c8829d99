"""The simulated CAN buses of a robot, with a simulated device for each node.

A program reaches a bus through a ``VirtualTimeInterface``.  A ``VirtualOperator`` carries out the
manual steps of commissioning.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.can import frame as can_frame
from thorvaldc.commissioning.plan import AttachStep
from thorvaldc.diagnostics import DiagnosticError, Report, did_you_mean
from thorvaldc.diagnostics.files import write_file
from thorvaldc.model import Actuator, Bus, Node, Robot
from thorvaldc.model.plugins import PluginFailure, PluginTable
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus import simulated_motors
from thorvaldc.simulation.bus.battery_and_io_devices import ForeignDevice
from thorvaldc.simulation.bus.described_device import DescribedDevice
from thorvaldc.simulation.bus.motor_wiring import WiredMotor, Wiring
from thorvaldc.simulation.bus.simulated_device import (
    MOTORS,
    DeviceSpecification,
    SimulatedDevice,
    hardware,
)
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import CanController, Wire
from thorvaldc.simulation.physics.sim_base import SimulatedJoints

if TYPE_CHECKING:
    from thorvaldc.compiler.source.node import Node as DocumentNode

# -- devices ---------------------------------------------------------------------------------------

_PACKAGE = "thorvaldc.simulation.bus"

SIMULATED_DEVICES: PluginTable[SimulatedDevice] = PluginTable(
    "thorvaldc.simulated_devices",
    SimulatedDevice,
    {
        "cia402": f"{_PACKAGE}.cia402_device:Cia402Drive",
        "thorvald_roboteq": f"{_PACKAGE}.roboteq_device:RoboteqController",
        "thorvald_roboteq_propulsion": f"{_PACKAGE}.roboteq_device:RoboteqController",
        "thorvald_kc_battery": f"{_PACKAGE}.battery_and_io_devices:KcBattery",
        "thorvald_io": f"{_PACKAGE}.battery_and_io_devices:IoBoard",
    },
)
"""By ``Node.protocol``.  docs/simulated-bus.md shows how a package adds a device."""


def create_device(specification: DeviceSpecification) -> SimulatedDevice:
    """Creates the simulated device of a CAN node.

    The protocol of the CAN node selects the class of the simulated device.  A CAN node with an
    unknown protocol becomes a ``DescribedDevice`` if its module names an EDS, else a
    ``ForeignDevice``.  Raises ``DiagnosticError``
    (``bus-driver-unknown``) if a class that another package provides is not a valid device class.
    """
    node = specification.node
    device = SIMULATED_DEVICES.load(node.protocol)
    if not isinstance(device, PluginFailure):
        return device(specification)
    if device.unknown and node.is_canopen and node.described:
        return DescribedDevice(specification)
    if device.unknown:
        return ForeignDevice(specification)
    raise DiagnosticError(
        "bus-driver-unknown",
        f"the simulated device for `{node.protocol}` {device.reason}",
        node.span,
    )


Memory = dict[str, dict[str, Any]]
"""Non-volatile memory by device name and key."""

# -- CAN interface in virtual time -----------------------------------------------------------------


class VirtualTimeInterface:
    """A ``CanInterface`` to a simulated bus in virtual time.

    Virtual time advances only while the program waits.  The receive queue has space for
    ``receive_limit`` CAN frames.  If the receive queue is full, a received CAN frame is dropped and
    ``overruns`` is increased by 1.  Real CAN controllers and operating systems drop frames in the
    same way.  ``bitrate`` is the bitrate of the CAN controller (bit/s), by default the bitrate of
    the simulated bus.
    """

    receives_by_itself = True
    epoch = 0.0
    """Offset (s) between timestamps and the times of the CAN interface."""

    def __init__(
        self,
        wire: Wire,
        name: str = "client",
        bitrate: int | None = None,
        *,
        send_limit: int = can_frame.SEND_LIMIT,
        receive_limit: int = can_frame.RECEIVE_LIMIT,
        receive_own: bool = False,
        listen_only: bool = False,
        fifo: bool = False,
    ) -> None:
        self.wire = wire
        self.timeline = wire.timeline
        self.name = name
        self.receive_limit = receive_limit
        self.overruns = 0
        self.received: deque[can_frame.ReceivedFrame] = deque()
        self.controller = CanController(
            wire,
            name,
            bitrate or wire.bitrate,
            queue_limit=send_limit,
            fifo=fifo,
            listen_only=listen_only,
            auto_recovery=False,
        )
        self.controller.on_frame = self._queue_received
        if receive_own:
            self.controller.on_sent = lambda frame: self._queue_received(frame, own=True)
        wire.attach(self.controller)
        self.controller.switch_on()

    @property
    def state(self) -> can_frame.ErrorState:
        return self.controller.state

    @property
    def now(self) -> float:
        """Virtual time (s)."""
        return self.timeline.seconds

    @property
    def received_until(self) -> float:
        return self.timeline.seconds

    def send(self, frame: can_frame.CanFrame, timeout: float = 0.0) -> bool:
        """Adds a CAN frame to the send queue.

        The method waits at most ``timeout`` s for space in the send queue.  Returns ``False`` if
        the send queue is still full, or if the CAN controller is in bus-off.
        """
        controller = self.controller
        if controller.pending >= controller.queue_limit and timeout > 0.0:
            limit = self.timeline.now + can_frame.to_ns(timeout)
            self.timeline.run_until(limit, lambda: controller.pending < controller.queue_limit)
        return controller.send(frame)

    def receive(self, timeout: float | None = None) -> can_frame.ReceivedFrame | None:
        """Returns the oldest CAN frame in the receive queue.

        Virtual time advances until a CAN frame is received.  Returns ``None`` if no CAN frame is
        received within ``timeout`` s.  If ``timeout`` is ``None``, the method returns ``None`` when
        the simulation has no further events.
        """
        if not self.received and (timeout is None or timeout > 0.0):
            limit = (
                can_frame.NEVER - 1
                if timeout is None
                else self.timeline.now + can_frame.to_ns(timeout)
            )
            if timeout is None:
                while not self.received and self.timeline.next_time < limit:
                    self.timeline.run_until(self.timeline.next_time)
            else:
                self.timeline.run_until(limit, lambda: bool(self.received))
        return self.received.popleft() if self.received else None

    def sleep(self, seconds: float) -> None:
        """Advances the virtual time by ``seconds`` s.

        CAN frames that are received during the wait are added to the receive queue.
        """
        self.timeline.run_until(self.timeline.now + can_frame.to_ns(seconds))

    def sleep_until(self, time: float) -> None:
        """Advances the virtual time to ``time`` (s).

        The method returns immediately if ``time`` is in the past.
        """
        self.timeline.run_until(can_frame.to_ns(time))

    def restart(self) -> None:
        """Restarts the CAN controller after bus-off."""
        self.controller.restart()

    def close(self) -> None:
        self.wire.detach(self.controller)

    def _queue_received(self, frame: can_frame.CanFrame, own: bool = False) -> None:
        if len(self.received) >= self.receive_limit:
            self.overruns += 1
        else:
            self.received.append(can_frame.ReceivedFrame(self.timeline.now, frame, own))


class SimulatedRobot:
    """The simulated CAN buses, devices and motors of a robot.

    * ``timeline``: virtual time of the simulation.
    * ``wires``: simulated bus lines by bus name.
    * ``devices``: simulated devices by node name.
    * ``motors``: models of the motors that turn the joints, by actuator name.

    The devices have no power before the call of ``power_on``.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        seed: int = 0,
        base: SimulatedJoints | None = None,
        delivered: bool = False,
        nonvolatile: Mapping[str, Mapping[str, Any]] | None = None,
        quirks: Iterable[Quirk] = (),
        wiring: Mapping[str, Wiring] | None = None,
    ) -> None:
        """Creates a simulated device for each node of the robot.

        * ``base``: simulated base whose joints the motors move, for example a ``MujocoBase``.  By
          default, the simulated motors are ideal motors without a simulated base.
        * ``delivered``: true if all devices are in the factory state.
        * ``nonvolatile``: values in the non-volatile memory by node name, for example
          ``{"fl_drive": {"node_id": 2}}``.  These values override the values from the robot model,
          also the ``serial`` number and the ``motors`` of a device, by channel.
        * ``quirks``: quirks of all simulated CANopen devices.
        * ``wiring``: connections that differ from the robot file, by the name of the actuator.

        Raises ``DiagnosticError`` (``bus-missing``) if the robot has no bus.
        """
        robot.require_bus()
        self.robot = robot
        self.seed = seed
        self.timeline = Timeline()
        self.wires: dict[str, Wire] = {}
        self.devices: dict[str, SimulatedDevice] = {}
        self.motors: dict[str, simulated_motors.MotorModel] = {}
        self._base_motors = None if base is None else simulated_motors.BaseMotors(robot, base)
        self._driven_wheels = simulated_motors.DrivenWheels()
        self._delivered = delivered
        self._quirks = frozenset(quirks)
        self._wiring = {a.name: Wiring() for a in robot.actuators if a.inverted}
        self._stored = nonvolatile or {}
        self._wiring.update(_stored_wiring(robot, self._stored))
        self._wiring.update(wiring or {})
        for bus in robot.buses:
            self.wires[bus.name] = Wire(self.timeline, bus.bitrate, seed=seed)
            for node in bus.nodes:
                self._add(bus, node, node.name, self._stored.get(node.name, {}))

    def power_on(self) -> None:
        """Switches the power of all devices on."""
        for device in self.devices.values():
            device.power_on()

    def power_off(self) -> None:
        for device in self.devices.values():
            device.power_off()

    def memory(self) -> Memory:
        """Returns the non-volatile memory of all devices, also of those not named by the robot."""
        names = [node.name for bus in self.robot.buses for node in bus.nodes]
        stored = {name: dict(values) for name, values in self._stored.items()}
        return {**stored, **{name: self.devices[name].nonvolatile for name in names}}

    def interface(
        self, bus: str | None = None, name: str = "master", **options: Any
    ) -> VirtualTimeInterface:
        """Opens a CAN interface to a bus in virtual time.

        The default CAN bus is the first CAN bus of the robot.
        """
        return VirtualTimeInterface(self.wire(bus), name, **options)

    def wire(self, bus: str | None = None) -> Wire:
        """Returns the simulated bus line of a bus.

        The default CAN bus is the first CAN bus of the robot.  Raises ``KeyError`` if the robot has
        no bus with the name ``bus``.
        """
        return self.wires[bus if bus is not None else self.robot.buses[0].name]

    def clone(self, node: str, name: str, **nonvolatile: Any) -> SimulatedDevice:
        """Adds a copy of the simulated device of the node ``node`` to the CAN bus.

        The copy of the device has ideal motors, no power and a different serial number.  The copy
        has the product code of the original device.  The copy also has the node id of the original
        device, unless ``nonvolatile`` contains another node id.  Raises ``KeyError`` if the robot
        has no node with the name ``node``.
        """
        for bus in self.robot.buses:
            for original in bus.nodes:
                if original.name == node:
                    return self._add(bus, original, name, nonvolatile, ideal_motors=True)
        raise KeyError(node)

    def run(self, seconds: float) -> None:
        """Runs the simulation for ``seconds`` s of virtual time."""
        self.timeline.run_until(self.timeline.now + can_frame.to_ns(seconds))

    def _add(
        self,
        bus: Bus,
        node: Node,
        name: str,
        nonvolatile: Mapping[str, Any],
        ideal_motors: bool = False,
    ) -> SimulatedDevice:
        def motor(actuator: Actuator) -> simulated_motors.MotorModel:
            if ideal_motors:
                return simulated_motors.ideal_motor(self.robot, actuator)
            return self._wired_motor(actuator)

        device = create_device(
            DeviceSpecification(
                self.robot,
                bus,
                node,
                self.wires[bus.name],
                motor,
                name,
                self.seed,
                self._delivered,
                {**hardware(self.robot, node, name), **nonvolatile},
                self._quirks,
            )
        )
        self.devices[name] = device
        return device

    def _wired_motor(self, actuator: Actuator) -> simulated_motors.MotorModel:
        """Returns the motor on the channel of an actuator, in the frame of the channel."""
        own = self._joint_motor(actuator)
        wiring = self._wiring.get(actuator.name)
        if wiring is None:
            return own
        actuators = {each.name: each for each in self.robot.actuators}
        turned = actuators[wiring.motor or actuator.name]
        measured = actuators[wiring.encoder or turned.name]
        pulses = measured.pulses_per_joint_turn
        if measured.inverted is not turned.inverted:
            pulses = -pulses
        return WiredMotor(
            self._joint_motor(turned),
            turned.max_velocity,
            encoder_of=self._joint_motor(measured),
            direction=-wiring.direction if turned.inverted else wiring.direction,
            encoder_scale=wiring.encoder_scale
            * pulses
            / (actuator.encoder_ppr * actuator.gear_ratio),
            zero=wiring.zero,
        )

    def _joint_motor(self, actuator: Actuator) -> simulated_motors.MotorModel:
        """Returns the model of the motor that turns the joint of an actuator."""
        model = self.motors.get(actuator.name)
        if model is None and self._base_motors is not None:
            model = self._base_motors.motor(actuator)
        if model is None:
            model = simulated_motors.ideal_motor(self.robot, actuator, self._driven_wheels)
        self.motors[actuator.name] = model
        return model


def _stored_wiring(
    robot: Robot, memory: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, Wiring]]:
    """Yields the channels whose motor is another than in the robot file, by the actuator there."""
    for bus in robot.buses:
        for node in bus.nodes:
            motors = memory.get(node.name, {}).get(MOTORS, {})
            for channel in node.channels:
                motor = motors.get(channel.name, channel.actuator)
                if channel.actuator is not None and motor != channel.actuator:
                    yield channel.actuator, Wiring(motor=motor)


# -- operator --------------------------------------------------------------------------------------

SETTLING_TIME = 0.3
"""Simulated time (s) that devices require to boot or to store the node id."""


class VirtualOperator:
    """Carries out the manual steps of commissioning on a simulated robot."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        self.simulated = simulated

    def attach(self, step: AttachStep, words: str) -> bool:
        """Switches the power of only one device on and sets the node id of the device.

        On a real robot, a person sets the node id with a tool of the manufacturer.  Returns whether
        the device has its id: one without a simulation of its own keeps its id for ever.
        """
        for device in self.simulated.devices.values():
            device.power_off()
        device = self.simulated.devices[step.node]
        device.power_on()
        self.simulated.run(SETTLING_TIME)
        try:
            device.change_node_id(step.after)
        except ValueError:
            return False
        self.simulated.run(SETTLING_TIME)
        return True

    def power_all(self, words: str) -> bool:
        """Switches the power of all devices on."""
        self.simulated.power_on()
        self.simulated.run(SETTLING_TIME)
        return True


# -- non-volatile memory in a file -----------------------------------------------------------------


def read_memory(path: Path, robot: Robot, report: Report) -> Memory | None:
    """Returns the stored values of the simulated devices of a robot.

    If the file does not exist, the function returns an empty mapping.  Returns ``None`` and reports
    errors if the content of the file is invalid.
    """
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.compiler.validation.document_check import check

    if not path.exists():
        return {}
    document = read_file(path, str(path), report)
    if document is None or not check(document, "device_memory", report):
        return None
    _check_motors(document, robot, report)
    memory: Memory = document.plain()
    return None if report.has_errors else memory


def _check_motors(document: DocumentNode, robot: Robot, report: Report) -> None:
    """Reports an error for a device of the robot that is wired to an unknown motor."""
    known = [actuator.name for actuator in robot.actuators]
    names = [node.name for bus in robot.buses for node in bus.nodes]
    for name, device in document.children():
        motors = device.get(MOTORS) if name in names else None
        for _, motor in motors.children() if motors is not None else ():
            if motor.value not in known:
                report.add(
                    "motor-unknown",
                    f"{name} is wired to `{motor.value}`, which is no motor of {robot.name}",
                    motor.span,
                    hint=did_you_mean(str(motor.value), known, f"its motors: {', '.join(known)}"),
                )


def write_memory(path: Path, simulated: SimulatedRobot) -> None:
    """Writes the non-volatile memory of all simulated devices to the JSON file."""
    write_file(path, json.dumps(simulated.memory(), indent=1, ensure_ascii=False) + "\n")
