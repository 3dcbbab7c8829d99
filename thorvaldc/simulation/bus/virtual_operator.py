"""The operator of simulated devices: power switches and the manufacturers' tools."""

from __future__ import annotations

from thorvaldc.commissioning.plan import AttachStep
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

SETTLING_TIME = 0.3
"""s of simulated time in which devices boot or store their id."""


class VirtualOperator:
    """Carries out manual commissioning steps on a simulated robot."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        self.simulated = simulated

    def attach(self, step: AttachStep, words: str) -> bool:
        """Powers one device alone and sets its id, as a person does with a manufacturer's tool."""
        for device in self.simulated.devices.values():
            device.power_off()
        device = self.simulated.devices[step.node]
        device.power_on()
        self.simulated.run(SETTLING_TIME)
        device.change_node_id(step.after)
        self.simulated.run(SETTLING_TIME)
        return True

    def power_all(self, words: str) -> bool:
        """Powers all devices."""
        self.simulated.power_on()
        self.simulated.run(SETTLING_TIME)
        return True
