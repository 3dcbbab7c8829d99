"""The CAN interface of a driver that stalls, and whose clock jumps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thorvaldc.can.frame import CanFrame, to_ns
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface

if TYPE_CHECKING:
    from tests.chaos.chaos_world import ChaosWorld


LONGEST_JUMP = 1.0
"""Largest shift (s) of the time of a frame: python-can's interfaces limit its age to 1 s."""


class ChaosInterface(VirtualTimeInterface):
    """The CAN interface of the driver, in whose ``send`` the driver may stall."""

    world: ChaosWorld

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        self.world.stall_while_sending()
        return super().send(frame, timeout)

    def jump(self, seconds: float) -> None:
        """Shifts the times of waiting frames, as a wall clock that is set."""
        now = self.timeline.now
        lowest = now - to_ns(LONGEST_JUMP)
        moved = [
            received._replace(time=min(max(received.time - to_ns(seconds), lowest), now))
            for received in self.received
        ]
        self.received.clear()
        self.received.extend(moved)
