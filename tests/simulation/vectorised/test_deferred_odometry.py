"""A run of which nobody reads the odometry has the same result, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.examples import example_robot
from tests.simulation.test_scenario_run import HEAD, simulation
from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import ParameterSet, Robot
from thorvaldc.runtime.se2 import ORIGIN, Twist
from thorvaldc.simulation.control_loop import ControlLoop, Segment, SimulationResult
from thorvaldc.simulation.simulation_run import Simulation
from thorvaldc.simulation.vectorised import calculator_batch

PLAN = (
    Segment(0.0, Twist(0.5, 0.0, 0.0)),
    Segment(1.0, Twist(0.4, 0.1, 0.3)),
    Segment(2.0, Twist(0.0, 0.0, 0.0)),
)


def nothing(loop: ControlLoop) -> None:
    """A function for each tick that reads nothing."""


def same(first: SimulationResult, second: SimulationResult) -> None:
    # As text, because a diverged run has values that are not numbers.
    assert repr(first.robots) == repr(second.robots)


def run_both(robot: Robot, on_tick: Callable[[ControlLoop], None] = nothing) -> SimulationResult:
    """Returns the result of a run, after a check that a run without samples has the same."""
    drive = Simulation(robot, emit(robot, ["mjcf"], Report()))
    sampled = drive.run(2.5, PLAN, on_tick=on_tick)
    same(drive.run(2.5, PLAN, on_tick=on_tick, sampled=False), sampled)
    return sampled


@pytest.mark.parametrize(
    "name", ["4wd4ws_slim", "6wd6ws_asymmetric", "2wd0ws_greenhouse", "car", "1wd1ws_front"]
)
def test_results_of_all_kinds_of_bases(name: str) -> None:
    (robot,) = run_both(example_robot(name)).robots
    assert 0.3 < robot.path_odometry < 1.5
    assert robot.end_error > 0.0


def test_the_odometry_is_deferred_without_samples_and_without_a_callback() -> None:
    robot = example_robot("4wd4ws_slim")
    drive = Simulation(robot, emit(robot, ["mjcf"], Report()))
    for sampled in (False, True):
        poses = []
        drive.run(
            1.0, PLAN, on_tick=lambda m, p=poses: p.append(m.driver.state.pose), sampled=sampled
        )
        assert (poses[-1] == ORIGIN) == (not sampled)
    same(drive.run(2.5, PLAN), drive.run(2.5, PLAN, on_tick=nothing))


def test_new_wheel_radii_apply_from_their_tick_on() -> None:
    robot = example_robot("4wd4ws_slim")
    radii = {"fl_wheel": 0.22, "rr_wheel": 0.21}
    wheels = tuple(replace(w, radii=(("worn", radii.get(w.name, w.radius)),)) for w in robot.wheels)
    worn = ParameterSet("worn", "worn", robot.driver, robot.span)
    robot = replace(robot, wheels=wheels, parameter_sets=(worn,))

    def change(loop: ControlLoop) -> None:
        if loop.ticks == 60:
            loop.driver.use("worn")

    changed = run_both(robot, change)
    assert changed.robots[0].end_error > 2.0 * run_both(robot).robots[0].end_error


@pytest.mark.parametrize("speed", [1e5, 1e12, float("nan")])
def test_diverged_runs(speed: float) -> None:
    def diverge(loop: ControlLoop) -> None:
        if loop.ticks == 50 and loop.scene is not None:
            loop.scene.data.qvel[10] = speed

    assert run_both(example_robot("4wd4ws_slim"), diverge).diverged


def test_long_runs_need_no_more_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calculator_batch, "_MOST_INTERVALS", 7)
    run_both(example_robot("4wd4ws_slim"))


@pytest.mark.parametrize("rate", [200.0, 1000.0, 1.0])
def test_a_driver_that_ticks_often_or_seldom(rate: float) -> None:
    robot = example_robot("4wd4ws_slim")
    run_both(replace(robot, driver=replace(robot.driver, rate=rate)))


@pytest.mark.parametrize(
    "disturbance",
    [
        "faults: [{type: encoder_frozen, wheel: fl_wheel, at: 1, until: 2},"
        " {type: encoder_frozen, wheel: rl_wheel, at: 1, until: 2}]",
        "faults: [{type: radius_error, wheel: fl_wheel, error: 5 %, at: 1}]",
        "faults: [{type: ice, wheel: fl_wheel, friction: 0.01}]",
        "noise: {seed: 2, steering_angle: 0.1 deg, wheel_speed: 0.01 rad/s, gyro: 0.01 rad/s}",
    ],
)
def test_scenarios_with_faults_and_noise(tmp_path: Path, disturbance: str) -> None:
    text = HEAD.replace("vx: 0.8 m/s", "vx: 0.8 m/s, wz: 0.2 rad/s")
    text = text.replace("4wd4ws_slim", "4wd4ws_wide")  # it has a gyro
    drive = simulation(tmp_path, text + disturbance + "\n")
    sampled = drive.play(Report())
    deferred = drive.play(Report(), hashed=False)
    assert deferred.metrics == sampled.metrics
    same(deferred.run, sampled.run)
