"""Rollouts of many runs equal single runs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.vectorised.rollouts import Rollouts

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def robot() -> Robot:
    robot = compile_file(ROOT / "examples/4wd2ws_tall/robot.yaml").model
    assert isinstance(robot, Robot)
    return robot


@pytest.fixture(scope="module")
def files(robot: Robot) -> dict[str, bytes]:
    return emit(robot, ["mjcf"])


def commands(n: int, ticks: int, wheels: int) -> tuple[np.ndarray, np.ndarray]:
    chance = np.random.default_rng(1)
    speeds = np.cumsum(chance.normal(0.0, 0.3, (n, ticks, wheels)), axis=1)
    return speeds, np.cumsum(chance.normal(0.0, 0.05, (n, ticks, wheels)), axis=1)


def test_rollouts_equal_single_steps(robot: Robot, files: dict[str, bytes]) -> None:
    n, ticks, period = 5, 8, 0.05
    speeds, angles = commands(n, ticks, 4)
    rollouts = Rollouts(robot, files, threads=2)
    starts = np.array([[k, -k, 0.5 * k] for k in range(n)], dtype=float)
    trajectories = rollouts.run(speeds, angles, period=period, states=rollouts.at(starts))
    rollouts.close()
    assert trajectories.time == pytest.approx(period * np.arange(1, ticks + 1))
    for run in range(n):
        scene = MujocoScene(files)
        base = MujocoBase(robot, scene)
        base.place(base.true_pose()._replace(x=starts[run, 0], y=starts[run, 1]))
        base.place(base.true_pose()._replace(yaw=starts[run, 2]))
        for k in range(ticks):
            base.write(JointCommands(speeds[run, k], angles[run, k]), 0.0)
            joints = base.read((k + 1) * period)
            pose, twist = base.true_pose(), base.true_twist()
            assert trajectories.poses[run, k, :2] == pytest.approx(pose[:2], abs=1e-6)
            turn = math.remainder(trajectories.poses[run, k, 2] - pose.yaw, math.tau)
            assert turn == pytest.approx(0.0, abs=1e-6)
            assert trajectories.twists[run, k] == pytest.approx(tuple(twist), abs=1e-4)
            assert trajectories.speeds[run, k] == pytest.approx(joints.speeds, abs=1e-3)
            assert trajectories.angles[run, k] == pytest.approx(joints.angles, abs=1e-5)
            assert trajectories.uprightness[run, k] == pytest.approx(base.uprightness(), abs=1e-6)


def test_threads_and_parts_do_not_change_the_result(robot: Robot, files: dict[str, bytes]) -> None:
    speeds, angles = commands(7, 6, 4)
    one = Rollouts(robot, files).run(speeds, angles)
    two = Rollouts(robot, files, threads=2).run(speeds, angles)
    assert (one.poses == two.poses).all()
    # A run can continue from the final states of another.
    rollouts = Rollouts(robot, files)
    first = rollouts.run(speeds[:, :3], angles[:, :3])
    then = rollouts.run(speeds[:, 3:], angles[:, 3:], states=first.states)
    assert then.poses == pytest.approx(one.poses[:, 3:], abs=1e-6)


def test_diverging_run_is_nan_and_the_others_are_finite(
    robot: Robot, files: dict[str, bytes]
) -> None:
    rollouts = Rollouts(robot, files)
    states = np.repeat(rollouts.start[None], 2, axis=0)
    states[1, 1 + rollouts.scene.model.nq] = math.nan
    trajectories = rollouts.run(np.zeros((2, 3, 4)), states=states)
    assert np.isfinite(trajectories.poses[0]).all()
    assert np.isnan(trajectories.poses[1]).all()


def test_shapes_are_checked(robot: Robot, files: dict[str, bytes]) -> None:
    rollouts = Rollouts(robot, files)
    for speeds, options in (
        (np.zeros((2, 3)), {}),
        (np.zeros((2, 3, 5)), {}),
        (np.zeros((2, 3, 4)), {"angles": np.zeros((2, 2, 4))}),
        (np.zeros((2, 3, 4)), {"period": 0.0071}),
        (np.zeros((2, 3, 4)), {"states": np.zeros((2, 3))}),
    ):
        with pytest.raises(ValueError, match=r"are|period"):
            rollouts.run(speeds, **options)
    with pytest.raises(ValueError, match="threads"):
        Rollouts(robot, files, threads=0)
