"""The slowest control cycle that the language allows drives a robot on its bus."""

from __future__ import annotations

import re

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.runtime.can_base.test_can_base import four_wheels
from tests.simulation.bus.robots import CIA402, at_home, compiled
from thorvaldc.runtime.can_base.base_fault import Cause
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

SCRIPT = re.sub(r', serial: "\w+"', "", CIA402.replace("cia402_propulsion", "propulsion"))
SETTINGS = "driver: {rate: 5 Hz, command_timeout: 2 s}\n"  # the lowest rate of the schema


@pytest.mark.slow
@pytest.mark.parametrize("text", [SCRIPT, CIA402], ids=["script", "cia402"])
def test_the_slowest_cycle_starts_drives_stops_and_ends(text: str) -> None:
    rig = Rig(at_home(compiled(text + SETTINGS)))
    rig.until(lambda: rig.driven.ready, 90.0)
    rig.run(1.0)
    for twist in (Twist(0.8, 0.0, 0.2), Twist(-0.8, 0.0, 0.2)):
        rig.drive(twist, 4.0)
        assert rig.driven.driver.state.odometry.twist.vx == pytest.approx(twist.vx, abs=0.02)
    rig.twist = ZERO_TWIST
    rig.driven.safety_stop()
    rig.run(4.0)
    assert (rig.state, rig.reason) == (BaseState.ESTOP, "the safety stop is engaged")
    assert rig.speed() < 1e-3
    rig.driven.shutdown()
    assert rig.reason == "the safety stop is engaged"


def test_cycles_that_last_too_long_are_named_as_such() -> None:
    """The frames of such a cycle are too old to be sent, on a bus without a fault."""
    rig = Rig(four_wheels())
    rig.drive()
    feed = rig.driven.feed
    assert feed is not None

    def slowly(driver: BaseDriver, now: float) -> None:
        feed(driver, now)
        rig.stall(1.1 * rig.base.period)

    rig.driven.feed = slowly
    rig.run(10 * rig.base.period)
    assert rig.base.state_machine.fault is not None
    assert rig.base.state_machine.fault.cause is Cause.GAP
    assert "control cycles in a row lasted too long; is the computer" in rig.reason
    rig.driven.feed = feed
    rig.run(2.0)
    assert rig.speed() == 0.0
