"""A node of a robot's bus, with everything that its simulated device is made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can.canopen import HEARTBEAT
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.bus import Bus, FrameDefinition, Node
from thorvaldc.simulation.bus.simulated_motors import IdealMotor, MotorModel
from thorvaldc.simulation.bus.wire import Wire

MASTER = "master"


@dataclass
class DeviceSpecification:
    """A node of a bus, for ``SimulatedDevice.from_specification``.

    ``motor`` returns the motor model of an actuator.  ``name`` is the node's, except for a
    clone.  ``delivered``: the device is in its factory state, without node id and parameters
    if these can be written over the bus.  ``nonvolatile`` replaces contents of its
    non-volatile memory (``node_id``, ``bitrate``, ...).
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

    @property
    def sent(self) -> list[FrameDefinition]:
        """Frames that the node sends."""
        return [frame for frame in self.bus.frames if frame.producer == self.node.name]

    @property
    def received(self) -> list[FrameDefinition]:
        """Frames from the master to this node alone."""
        return [
            frame
            for frame in self.bus.frames
            if frame.producer == MASTER and frame.consumers == (self.node.name,)
        ]

    def period(self, cob_id: int, default: float) -> float:
        """Period (s) of the node's frame with this identifier; ``default`` if it has none."""
        periods = (frame.period for frame in self.sent if frame.cob_id == cob_id)
        return next((period for period in periods if period is not None), default)

    @property
    def heartbeat_period(self) -> float:
        """s; 0: the node sends no heartbeat."""
        return self.period(HEARTBEAT + self.node.id, 0.0)

    def property(self, name: str) -> Any:
        """A property of the node's module, ``None`` if it has none of this name."""
        return dict(self.node.properties).get(name)

    def actuator(self, channel: str) -> Actuator | None:
        """The actuator connected to a channel of the node."""
        name = next(c.actuator for c in self.node.channels if c.name == channel)
        return next((actuator for actuator in self.robot.actuators if actuator.name == name), None)

    def motor_of(self, actuator: Actuator | None) -> MotorModel:
        """The motor model of an actuator; without an actuator, a motor that drives nothing."""
        return IdealMotor(1.0, 1.0) if actuator is None else self.motor(actuator)

    def common(self) -> dict[str, Any]:
        """Keyword arguments of every ``SimulatedDevice``."""
        return {"seed": self.seed, "nonvolatile": self.nonvolatile}
