"""The slowest control cycle that the language allows drives a robot on its bus."""

from __future__ import annotations

import re

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import CIA402, at_home, compiled
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

SCRIPT = re.sub(r', serial: "\w+"', "", CIA402.replace("cia402_propulsion", "propulsion"))
SETTINGS = "driver: {rate: 5 Hz, command_timeout: 2 s}\n"  # the lowest rate of the schema


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
