"""The data from which the simulated device of a CAN node is created."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can.canopen import HEARTBEAT
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.bus import Bus, FrameDefinition, Node
from thorvaldc.model.bus_quirks import Quirk
from thorvaldc.simulation.bus.simulated_motors import IdealMotor, MotorModel
from thorvaldc.simulation.bus.wire import Wire

MASTER = "master"


@dataclass
class DeviceSpecification:
    """The data of a CAN node from which ``SimulatedDevice.from_specification`` creates a device.

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
    * ``nonvolatile``: values that replace values in the non-volatile memory of the device, such as
      ``node_id`` or ``bitrate``.
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

    def period(self, cob_id: int, default: float) -> float:
        """Returns the period (s) of the CAN frame with the identifier ``cob_id`` that the node
        sends.

        Returns ``default`` if the node does not send the CAN frame periodically.
        """
        periods = (frame.period for frame in self.sent if frame.cob_id == cob_id)
        return next((period for period in periods if period is not None), default)

    @property
    def heartbeat_period(self) -> float:
        """Period of the heartbeat (s), or 0 if the node sends no heartbeat."""
        return self.period(HEARTBEAT + self.node.id, 0.0)

    def property(self, name: str) -> Any:
        """Returns a property of the robot module with the node, or ``None`` if unknown."""
        return dict(self.node.properties).get(name)

    def actuator(self, channel: str) -> Actuator | None:
        """Returns the actuator at a channel of the motor controller, or ``None``."""
        name = next(c.actuator for c in self.node.channels if c.name == channel)
        return next((actuator for actuator in self.robot.actuators if actuator.name == name), None)

    def motor_of(self, actuator: Actuator | None) -> MotorModel:
        """Returns the motor model of an actuator.

        If ``actuator`` is ``None``, the function returns a motor without a load.
        """
        return IdealMotor(1.0, 1.0) if actuator is None else self.motor(actuator)

    def common(self) -> dict[str, Any]:
        """Returns the keyword arguments that every subclass of ``SimulatedDevice`` accepts."""
        return {"seed": self.seed, "nonvolatile": self.nonvolatile}
