"""A simulated operator who carries out the manual steps of commissioning."""

from __future__ import annotations

from thorvaldc.commissioning.plan import AttachStep
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

SETTLING_TIME = 0.3
"""Simulated time (s) that devices require to boot or to store the node id."""


class VirtualOperator:
    """Carries out the manual steps of commissioning on a simulated robot."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        self.simulated = simulated

    def attach(self, step: AttachStep, words: str) -> bool:
        """Switches the power of only one device on and sets the node id of the device.

        On a real robot, a person sets the node id with a tool of the manufacturer.
        """
        for device in self.simulated.devices.values():
            device.power_off()
        device = self.simulated.devices[step.node]
        device.power_on()
        self.simulated.run(SETTLING_TIME)
        device.change_node_id(step.after)
        self.simulated.run(SETTLING_TIME)
        return True

    def power_all(self, words: str) -> bool:
        """Switches the power of all devices on."""
        self.simulated.power_on()
        self.simulated.run(SETTLING_TIME)
        return True
