"""The encoder of a steering joint jumps: the robot stops, and homes the joint after a reset."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.simulation.bus.robots import ROBOTS
from tests.slow import mostly_exhaustive
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.simulation.bus.fault_injection import FaultInjector


def jump(rig: Rig, angle: float) -> None:
    fault = BusFault(
        "encoder_jump", "main", "fl_controller", 0.0, None, SPAN, channel="steering", angle=angle
    )
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


@pytest.mark.parametrize("robot", mostly_exhaustive(ROBOTS.values()), ids=ROBOTS)
@pytest.mark.parametrize("drives", [False, True])
def test_a_jump_stops_the_robot_which_homes_again(robot: Callable[[], Robot], drives: bool) -> None:
    rig = Rig(robot())
    rig.ready()
    if drives:
        rig.drive(FORWARD, 1.0)
    start = rig.now
    jump(rig, 0.5)
    rig.run(0.1)
    assert rig.state is BaseState.FAULT
    assert "fl_controller: the encoder of steering jumped by 2" in rig.reason
    assert rig.now - start < 0.11
    rig.twist = ZERO_TWIST
    rig.run(2.0)
    rig.driven.reset()
    rig.ready()
    motor = rig.simulated.motors["fl_steering_steering"]
    assert motor.read(rig.now).position == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("robot", mostly_exhaustive(ROBOTS.values()), ids=ROBOTS)
def test_a_fast_motion_is_no_jump(robot: Callable[[], Robot]) -> None:
    rig = Rig(robot())
    rig.ready()
    for wz in (1.5, -1.5, 1.5):
        rig.drive(FORWARD._replace(vx=0.3, wz=wz), 1.0)
    jump(rig, 0.1)
    rig.run(0.2)
    assert rig.state is BaseState.ACTIVE, "too small to be seen"
