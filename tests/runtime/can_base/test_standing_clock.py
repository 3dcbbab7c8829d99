"""A computer whose clock stands while the bus goes on."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import ROBOTS, roboteq
from tests.slow import mostly_exhaustive
from thorvaldc.can.frame import CanFrame, ReceivedFrame, to_ns
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface


class StandingClock:
    """Clock of a bus that loses time; frames of that time arrive when it goes on."""

    receives_by_itself = True
    overruns = 0

    def __init__(self, interface: VirtualTimeInterface) -> None:
        self.interface = interface
        self._lost = 0.0
        self._last_time = 0

    def stand(self, seconds: float) -> None:
        self.interface.sleep(seconds)
        self._lost += seconds

    @property
    def now(self) -> float:
        return self.interface.now - self._lost

    @property
    def received_until(self) -> float:
        return self.now

    @property
    def state(self) -> object:
        return self.interface.state

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        return self.interface.send(frame, timeout)

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        received = self.interface.receive(timeout)
        if received is None:
            return None
        self._last_time = max(self._last_time, received.time - to_ns(self._lost))
        return received._replace(time=self._last_time)

    def sleep(self, seconds: float) -> None:
        self.interface.sleep(seconds)

    def sleep_until(self, time: float) -> None:
        self.interface.sleep_until(time + self._lost)

    def restart(self) -> None:
        self.interface.restart()

    def close(self) -> None:
        self.interface.close()


def driving(robot: Robot) -> tuple[Rig, StandingClock]:
    """Returns a rig that drives, and its clock."""
    rig = Rig(robot)
    clock = StandingClock(rig.interfaces["main"])
    rig.base = CanBase(robot, {"main": clock}, threaded=False)  # type: ignore[dict-item]
    rig.interface = clock  # type: ignore[assignment]
    rig.driven = DrivenRobot(robot, rig.base, clock)  # type: ignore[arg-type]
    rig.driven.feed, rig.driven.before_cycle = rig._command, rig._operate
    rig.drive(Twist(0.8, 0.0, 0.0), 1.0)
    return rig, clock


@pytest.mark.parametrize("make", mostly_exhaustive(ROBOTS.values()), ids=ROBOTS)
def test_a_clock_that_stood_for_longer_than_the_watchdogs(make: Callable[[], Robot]) -> None:
    """The drives have braked meanwhile, and the driver must not accelerate them again."""
    rig, clock = driving(make())
    clock.stand(0.7)
    assert rig.speed() < 0.6
    fastest = rig.speed()
    for _ in range(100):
        rig.run(0.01)
        assert rig.speed() <= fastest + 0.02
        fastest = min(fastest, rig.speed())
    assert rig.state is BaseState.FAULT
    assert "more than the clock of the computer shows; did it sleep" in rig.reason
    assert rig.speed() == 0.0
    rig.twist = Twist(0.0, 0.0, 0.0)
    rig.run(0.1)
    rig.driven.reset()
    rig.until(lambda: rig.driven.ready)


@pytest.mark.parametrize(("seconds", "stops"), [(0.3, True), (0.15, True), (0.04, False)])
def test_shorter_times(seconds: float, stops: bool) -> None:
    rig, clock = driving(roboteq())
    clock.stand(seconds)
    rig.run(0.3)
    assert (rig.state is BaseState.FAULT) is stops, rig.reason
    assert rig.base.connections[0].rates.missed_time == pytest.approx(
        seconds if stops else 0.0, abs=0.08
    )
