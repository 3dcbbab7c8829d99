"""A late process is no silent node: the receiving thread, and the process of a simulated bus."""

from __future__ import annotations

import pytest

from tests.examples import example_robot
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import drives
from thorvaldc.can.frame import ReceivedFrame
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface

PERIOD = 0.02


class LateBus(VirtualTimeInterface):
    """A bus whose process does not run for a time: its frames come later, all together."""

    stops_at = resumes_at = 0.0

    def stop(self, seconds: float) -> None:
        self.stops_at, self.resumes_at = self.now, self.now + seconds

    @property
    def received_until(self) -> float:
        return self.stops_at if self.now < self.resumes_at else self.now

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        return None if self.now < self.resumes_at else super().receive(timeout)


def driving(kind: str) -> tuple[Rig, LateBus]:
    rig = Rig(drives() if kind == "cia402" else example_robot("4wd4ws_wide"))
    assert isinstance(rig.interface, VirtualTimeInterface)
    rig.interface.__class__ = LateBus
    rig.drive()
    assert isinstance(rig.interface, LateBus)
    return rig, rig.interface


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cia402", "script"])
def test_a_late_process_of_the_bus_is_no_silent_node(kind: str) -> None:
    rig, bus = driving(kind)
    for _ in range(10):
        bus.stop(0.45)
        rig.run(0.8)
        assert rig.state.drives, rig.reason
    rig.run(0.5)
    assert rig.state is BaseState.READY, "the motion was unknown, so that zero comes first"
    assert rig.driven.armed
    rig.twist = ZERO_TWIST
    rig.run(0.1)
    rig.drive()


@pytest.mark.parametrize("kind", ["cia402", "script"])
def test_a_process_of_the_bus_that_is_too_late_is_named(kind: str) -> None:
    rig, bus = driving(kind)
    bus.stop(5.0)
    assert rig.until(lambda: rig.state is BaseState.FAULT, 1.0) <= 0.5 + 2 * PERIOD
    assert "the simulation of the bus `main` runs 5" in rig.reason
    assert "ms late; is the computer too busy?" in rig.reason
    rig.run(2.0)
    assert rig.speed() == 0.0


def test_a_node_that_is_silent_on_a_late_bus_is_noticed_when_the_bus_runs_again() -> None:
    rig, bus = driving("script")
    bus.stop(0.2)
    rig.simulated.devices["fl_controller"].power_off()
    assert rig.until(lambda: rig.state is BaseState.FAULT, 1.0) < 0.2 + 2 * PERIOD
    assert rig.reason.startswith("fl_controller: no tpdo1 for ")


def test_a_late_receiving_thread_is_no_silent_node_for_two_periods() -> None:
    """The frames of three cycles wait in the interface; without an end of this, a fault follows
    within the stated 100 ms and the two cycles."""
    rig, _ = driving("script")
    receiver = rig.base.connections[0].receiver
    drain = receiver.drain
    for _ in range(5):
        receiver.drain = list  # type: ignore[method-assign]
        rig.run(3 * PERIOD)
        receiver.drain = drain  # type: ignore[method-assign]
        rig.run(0.5)
        assert rig.state is BaseState.ACTIVE, rig.reason
    receiver.drain = list  # type: ignore[method-assign]
    assert rig.until(lambda: rig.state is BaseState.FAULT, 1.0) < 0.14
