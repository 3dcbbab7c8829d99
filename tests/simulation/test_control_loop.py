"""What a run lets its watcher see, tick by tick."""

from __future__ import annotations

import math

import pytest

from tests.backend_files import files_of
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.simulation_run import Simulation

ROBOT = make_robot(FOUR_STEERED)
ASKED = Twist(0.5, 0.1, 1.2)


def samples(simulation: Simulation, duration: float) -> list[Sample]:
    seen: list[Sample] = []

    def on_tick(loop: ControlLoop) -> None:
        seen.append(loop.sample())

    simulation.run(duration, ASKED, on_tick=on_tick)
    return seen


def test_each_tick_is_seen_once() -> None:
    seen = samples(Simulation(ROBOT), 1.0)
    rate = ROBOT.driver.rate
    assert [s.time for s in seen] == pytest.approx([k / rate for k in range(round(rate) + 1)])
    assert all(s.commanded == ASKED for s in seen)
    assert seen[0].limited.speed < 0.1  # the ramp
    assert seen[-1].true == seen[-1].estimated
    assert seen[-1].pose_true == seen[-1].pose_estimated


def test_truth_is_the_physics_and_yaw_is_counted() -> None:
    pytest.importorskip("mujoco")
    seen = samples(Simulation(ROBOT, files_of(Mjcf, ROBOT)), 8.0)
    last = seen[-1]
    assert last.true != last.estimated
    assert last.true == pytest.approx(last.limited, abs=0.02)
    assert last.estimated == pytest.approx(last.limited, abs=0.02)
    assert last.pose_true != last.pose_estimated
    assert last.pose_true == pytest.approx(last.pose_estimated, abs=0.1)
    assert last.pose_true.yaw > 1.2 * math.tau
    assert last.joints is not None
