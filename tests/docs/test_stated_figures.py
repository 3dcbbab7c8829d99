"""Figures that pages state are those of the present simulation."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from bench import consistency
from bench.figure import ROOT
from tests.examples import example_robot
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Brake, Robot
from thorvaldc.runtime.calculators import Noise
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import Segment
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.simulation_run import Simulation

ROBOT = example_robot("4wd4ws_wide")


def rolled(robot: Robot, slope: float) -> float:
    """Returns how far (m) a robot rolls down a slope (deg) in 5 s without power."""
    scene = MujocoScene(emit(ROBOT, ["mjcf"]))
    angle = math.radians(slope)
    scene.model.opt.gravity[:] = (-9.81 * math.sin(angle), 0.0, -9.81 * math.cos(angle))
    base = MujocoBase(robot, scene)
    base.read(3.0)
    for i in range(len(robot.wheels)):
        base.switch_motor(i, False, False, 3.0)
    start = base.true_pose().x
    base.read(8.0)
    return abs(base.true_pose().x - start)


def test_paths_on_slopes_of_the_page_on_safety() -> None:
    assert rolled(ROBOT, 6.0) == pytest.approx(6.2, abs=0.05)
    # 2 N m behind a gear of 42:1; the brake closes in 0.1 s.
    brake = Brake(2.0 * 42.0, 0.1)
    motors = tuple(replace(motor, brake=brake) for motor in ROBOT.actuators)
    assert rolled(replace(ROBOT, actuators=motors), 15.0) == pytest.approx(0.017, abs=0.002)


@pytest.mark.parametrize("name", ["4wd4ws_wide", "9wd9ws"])
def test_rolling_radius_of_the_page_on_contacts(name: str) -> None:
    robot = example_robot(name)
    simulation = Simulation(robot, emit(robot, ["mjcf"]))
    run = simulation.run(10.0, [Segment(0.0, Twist(0.8, 0.0, 0.0))], None, lambda loop: None)
    result = run.robots[0]
    assert result.path_odometry == pytest.approx(result.path_true, rel=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "row"),
    list(zip(consistency.KINDS, ("white", "lasting 2 s", "wrong radii"), strict=True)),
)
def test_consistency_of_the_page_on_base_calculators(
    kind: str, row: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 30 runs of one robot in place of 200 of each."""
    monkeypatch.setattr(consistency, "RUNS", 30)
    page = (ROOT / "docs/base-calculators.md").read_text(encoding="utf-8")
    stated = re.search(
        rf"^\| {row}.*?\| ([\d.]+) to ([\d.]+) \| ([\d.]+) to ([\d.]+) \|", page, re.M
    )
    assert stated is not None
    ends = [float(text) for text in stated.groups()]
    results = consistency.study("4WD4WS", kind, [consistency.KINDS[kind], Noise()], 77.0)
    for result, low, high in zip(results, ends[::2], ends[1::2], strict=True):
        margin = 3.0 * result.pose_error
        assert low - margin < result.pose < high + margin
