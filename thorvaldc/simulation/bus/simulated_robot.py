"""A robot's buses with a simulated device for each of their nodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from thorvaldc.can.nanoseconds import to_ns
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.bus import Bus, Node
from thorvaldc.model.buses import require_bus
from thorvaldc.runtime.base_interface import BaseHandle
from thorvaldc.simulation.bus.device_builders import Build, build
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_motors import BaseMotors, MotorModel, ideal_motor
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.virtual_time_interface import VirtualTimeInterface
from thorvaldc.simulation.bus.wire import Wire


class SimulatedRobot:
    """One timeline; a wire for each bus; a device, and its motors, for each node.

    ``wires`` by the bus's name, ``devices`` by the node's, ``motors`` by the actuator's.
    All is without power until ``power_on``.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        seed: int = 0,
        base: BaseHandle | None = None,
        delivered: bool = False,
        nonvolatile: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """``base``: whose joints the motors move (a ``MujocoBase``, say); ideal ones without.

        ``delivered``: devices come as their makers send them.  ``nonvolatile`` says, by node, what
        a device keeps without power, over what the robot says: ``{"fl_drive": {"node_id": 2}}``.

        Raises ``DiagnosticError`` (``bus-missing``) for a robot without a bus.
        """
        require_bus(robot)
        self.robot = robot
        self.seed = seed
        self.timeline = Timeline()
        self.wires: dict[str, Wire] = {}
        self.devices: dict[str, SimulatedDevice] = {}
        self.motors: dict[str, MotorModel] = {}
        self._base_motors = None if base is None else BaseMotors(robot, base)
        self._delivered = delivered
        for bus in robot.buses:
            self.wires[bus.name] = Wire(self.timeline, bus.bitrate, seed=seed)
            for node in bus.nodes:
                self._add(bus, node, node.name, (nonvolatile or {}).get(node.name, {}))

    def power_on(self) -> None:
        """All of them at once."""
        for device in self.devices.values():
            device.power_on()

    def power_off(self) -> None:
        for device in self.devices.values():
            device.power_off()

    def interface(
        self, bus: str | None = None, name: str = "master", **options: Any
    ) -> VirtualTimeInterface:
        """A place on a bus, by default the first, for a program in virtual time."""
        return VirtualTimeInterface(self.wire(bus), name, **options)

    def wire(self, bus: str | None = None) -> Wire:
        """Of the bus of that name, by default of the first.  Raises ``KeyError``."""
        return self.wires[bus if bus is not None else self.robot.buses[0].name]

    def clone(self, node: str, name: str, **nonvolatile: Any) -> SimulatedDevice:
        """One more device like that of ``node``, with ideal motors and without power.

        It is the same product with the same id, but for what ``nonvolatile`` says, and has a
        serial number of its own where it has one.  Raises ``KeyError``.
        """
        for bus in self.robot.buses:
            for found in bus.nodes:
                if found.name == node:
                    return self._add(bus, found, name, nonvolatile, own_motors=True)
        raise KeyError(node)

    def run(self, seconds: float) -> None:
        """Let time run with nobody's program on the bus."""
        self.timeline.run_until(self.timeline.now + to_ns(seconds))

    def _add(
        self,
        bus: Bus,
        node: Node,
        name: str,
        nonvolatile: Mapping[str, Any],
        own_motors: bool = False,
    ) -> SimulatedDevice:
        def motor(actuator: Actuator) -> MotorModel:
            found = None
            if self._base_motors is not None and not own_motors:
                found = self._base_motors.motor(actuator)
            if found is None:
                found = ideal_motor(actuator, self.robot.joint(actuator.joint))
            if not own_motors:
                self.motors[actuator.name] = found
            return found

        device = build(
            Build(
                self.robot,
                bus,
                node,
                self.wires[bus.name],
                motor,
                name,
                self.seed,
                self._delivered,
                nonvolatile,
            )
        )
        self.devices[name] = device
        return device
