"""The simulated CAN buses of a robot, with a simulated device for each node."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from thorvaldc.can.nanoseconds import to_ns
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.bus import Bus, Node
from thorvaldc.model.bus_quirks import Quirk
from thorvaldc.model.require_bus import require_bus
from thorvaldc.simulation.bus.device_specification import DeviceSpecification
from thorvaldc.simulation.bus.device_table import create_device
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_motors import (
    BaseMotors,
    DrivenWheels,
    MotorModel,
    ideal_motor,
)
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.virtual_time_interface import VirtualTimeInterface
from thorvaldc.simulation.bus.wire import Wire
from thorvaldc.simulation.physics.simulated_joints import SimulatedJoints


class SimulatedRobot:
    """The simulated CAN buses, devices and motors of a robot.

    * ``timeline``: virtual time of the simulation.
    * ``wires``: simulated bus lines by bus name.
    * ``devices``: simulated devices by node name.
    * ``motors``: motor models by actuator name.

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
    ) -> None:
        """Creates a simulated device for each node of the robot.

        * ``base``: simulated base whose joints the motors move, for example a ``MujocoBase``.  By
          default, the simulated motors are ideal motors without a simulated base.
        * ``delivered``: true if all devices are in the factory state.
        * ``nonvolatile``: values in the non-volatile memory by node name, for example
          ``{"fl_drive": {"node_id": 2}}``.  These values override the values from the robot model.
        * ``quirks``: quirks of all simulated CANopen devices.

        Raises ``DiagnosticError`` (``bus-missing``) if the robot has no bus.
        """
        require_bus(robot)
        self.robot = robot
        self.seed = seed
        self.timeline = Timeline()
        self.wires: dict[str, Wire] = {}
        self.devices: dict[str, SimulatedDevice] = {}
        self.motors: dict[str, MotorModel] = {}
        self._base_motors = None if base is None else BaseMotors(robot, base)
        self._driven_wheels = DrivenWheels()
        self._delivered = delivered
        self._quirks = frozenset(quirks)
        for bus in robot.buses:
            self.wires[bus.name] = Wire(self.timeline, bus.bitrate, seed=seed)
            for node in bus.nodes:
                self._add(bus, node, node.name, (nonvolatile or {}).get(node.name, {}))

    def power_on(self) -> None:
        """Switches the power of all devices on."""
        for device in self.devices.values():
            device.power_on()

    def power_off(self) -> None:
        for device in self.devices.values():
            device.power_off()

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
        self.timeline.run_until(self.timeline.now + to_ns(seconds))

    def _add(
        self,
        bus: Bus,
        node: Node,
        name: str,
        nonvolatile: Mapping[str, Any],
        ideal_motors: bool = False,
    ) -> SimulatedDevice:
        def motor(actuator: Actuator) -> MotorModel:
            model = None
            if self._base_motors is not None and not ideal_motors:
                model = self._base_motors.motor(actuator)
            if model is None:
                wheels = None if ideal_motors else self._driven_wheels
                model = ideal_motor(self.robot, actuator, wheels)
            if not ideal_motors:
                self.motors[actuator.name] = model
            return model

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
                nonvolatile,
                self._quirks,
            )
        )
        self.devices[name] = device
        return device
