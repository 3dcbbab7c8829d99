"""Who powers modules and sets ids by hand: a person at a terminal, or nobody in a simulation."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from thorvaldc.commissioning.plan import AttachStep
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot


class Person:
    """Reads, does, and says so by the Enter key."""

    def attach(self, step: AttachStep, words: str) -> bool:
        return self._ask(f"{words} Press Enter when it is done, or type `skip`. ")

    def power_all(self, words: str) -> bool:
        return self._ask(f"{words} Press Enter when it is done. ")

    def _ask(self, words: str) -> bool:
        print(words, end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        return bool(line) and line.strip().lower() not in ("skip", "s")


class VirtualOperator:
    """Does what is asked to simulated devices: power, and what makers' tools do."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        self.simulated = simulated

    def attach(self, step: AttachStep, words: str) -> bool:
        for device in self.simulated.devices.values():
            device.power_off()
        device = self.simulated.devices[step.node]
        device.power_on()
        self.simulated.run(0.3)
        device.change_node_id(step.after)
        self.simulated.run(0.3)
        return True

    def power_all(self, words: str) -> bool:
        self.simulated.power_on()
        self.simulated.run(0.3)
        return True
