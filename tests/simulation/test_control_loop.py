"""Samples of a run: the callback gets the measurements of every tick."""

from __future__ import annotations

import math

import pytest

from tests.backend_files import files_of
from tests.robots import FOUR_STEERED, make_robot
from tests.runtime.test_lasting_difference import HalfAsFast
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import ControlLoop, Sample, Segment
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.simulation_run import Simulation

ROBOT = make_robot(FOUR_STEERED)
COMMANDED = Twist(0.5, 0.1, 1.2)


def samples(simulation: Simulation, duration: float) -> list[Sample]:
    ticks: list[Sample] = []

    def on_tick(loop: ControlLoop) -> None:
        ticks.append(loop.sample())

    simulation.run(duration, COMMANDED, on_tick=on_tick)
    return ticks


def test_callback_gets_each_tick_once() -> None:
    ticks = samples(Simulation(ROBOT), 1.0)
    rate = ROBOT.driver.rate
    assert [s.time for s in ticks] == pytest.approx([k / rate for k in range(round(rate) + 1)])
    assert all(s.commanded == COMMANDED for s in ticks)
    assert ticks[0].limited.speed < 0.1  # the ramp
    assert ticks[-1].true == ticks[-1].estimated
    assert ticks[-1].pose_true == ticks[-1].pose_estimated


def test_true_motion_is_that_of_the_physics_and_yaw_is_not_wrapped() -> None:
    pytest.importorskip("mujoco")
    ticks = samples(Simulation(ROBOT, files_of(Mjcf, ROBOT)), 8.0)
    last = ticks[-1]
    assert last.true != last.estimated
    assert last.true == pytest.approx(last.limited, abs=0.02)
    assert last.estimated == pytest.approx(last.limited, abs=0.02)
    assert last.pose_true != last.pose_estimated
    assert last.pose_true == pytest.approx(last.pose_estimated, abs=0.1)
    assert last.pose_true.yaw > 1.2 * math.tau
    assert last.joints is not None


def test_a_command_that_is_not_followed_is_counted_as_commanded() -> None:
    """The wheels aim at half of the ramped twist for ever: only the first seconds are theirs."""
    loop = ControlLoop("robot", ROBOT, SimBase(ROBOT), [Segment(0.0, Twist(0.6, 0.0, 0.0))])
    loop.driver.calculator = HalfAsFast(BaseGeometry.from_robot(ROBOT))
    while loop.next_time < 20.0:
        loop.tick()
    assert "cause unknown" in loop.not_followed
    state, result = loop.driver.state, loop.result()
    assert state.command is not None
    assert loop.sample().limited == state.ramped != state.command.target
    assert result.path_commanded > 1.5 * result.path_true
