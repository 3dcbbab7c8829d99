"""Environments in one batch: equal to single environments to the last bit, and their errors."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.outside_tools import without
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.tools.gym import environments
from thorvaldc.tools.gym.batch_physics import MujocoPhysics, World
from thorvaldc.tools.gym.robot_vector_env import RobotVectorEnv

ROOT = Path(__file__).resolve().parents[3]
SLIM = ROOT / "examples/4wd4ws_slim/robot.yaml"
TALL = ROOT / "examples/4wd2ws_tall/robot.yaml"
FLEET = ROOT / "examples/fleet_of_four/fleet.yaml"
FIELD = ROOT / "examples/scenarios/field_edge.yaml"
SCENARIO = f"""thorvaldc: 1
scenario: faulty
robots: {{cart: {{robot: {SLIM}}}}}
duration: 2 s
noise: {{wheel_speed: 0.1 rad/s}}
world:
  friction: 0.8
  zones:
    - {{xyz: [1 m, 0, 0], size: [1 m, 4 m], friction: 0.3}}
  obstacles:
    post: {{shape: box, xyz: [1.6 m, 0, 0], size: [200 mm, 2 m, 1 m]}}
faults:
  - {{type: motor_lost, wheel: fl_wheel, motor: drive, at: 0.5 s, until: 1.2 s}}
"""
NUMBER = 3


@pytest.fixture(autouse=True, scope="module")
def batch() -> None:
    try:
        import mujoco.batch  # noqa: F401
    except ImportError:
        without("the batch needs MuJoCo 3.17")


@pytest.fixture
def gymnasium() -> Any:
    import gymnasium

    return gymnasium


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "faulty.yaml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


def forward(step: Any) -> float:
    distance: float = step.after.pose_true.x - step.before.pose_true.x
    return distance - step.collisions - 10.0 * step.terminated


def both(gymnasium: Any, file: Path, **options: Any) -> Iterator[Any]:
    """The environments in one batch, and one after the other."""
    options = {"reward": forward, "spread": (0.1, 0.1, 0.2), **options}
    mode = options.pop("autoreset_mode", gymnasium.vector.AutoresetMode.NEXT_STEP)
    yield gymnasium.make_vec(
        environments.NAME, NUMBER, file=str(file), autoreset_mode=mode, **options
    )
    yield gymnasium.vector.SyncVectorEnv(
        [lambda: environments.make(file, **options)] * NUMBER, autoreset_mode=mode
    )


def equal(batched: Any, single: Any, where: str) -> None:
    """Compares observations, results and nested information to the last bit."""
    if isinstance(single, dict):
        assert batched.keys() == single.keys(), where
        for key in single:
            equal(batched[key], single[key], f"{where}, {key}")
    elif isinstance(single, tuple) or (isinstance(single, np.ndarray) and single.dtype == object):
        for i, (a, b) in enumerate(zip(batched, single, strict=True)):
            equal(a, b, f"{where}[{i}]")
    else:
        assert np.array_equal(batched, single), where


def play(envs: list[Any], steps: int) -> list[Any]:
    """Compares two vector environments; returns the results of all steps."""
    equal(*[env.reset(seed=[7, 8, 9]) for env in envs], where="reset")
    rng = np.random.default_rng(1)
    results = []
    for count in range(steps):
        action = rng.uniform(-1.0, 1.0, envs[0].action_space.shape).astype(np.float32)
        action[:, 0] = abs(action[:, 0])
        batched, single = (env.step(action) for env in envs)
        for i, name in enumerate(("observation", "reward", "terminated", "truncated", "info")):
            equal(batched[i], single[i], f"step {count}, {name}")
        results.append(single)
    return results


@pytest.mark.parametrize(
    ("file", "options"),
    [
        pytest.param(SLIM, {}, marks=pytest.mark.exhaustive),
        (TALL, {"action": "joints"}),
        pytest.param(FLEET, {"robot": "six", "rate": 5.0}, marks=pytest.mark.slow),
        (FIELD, {"rate": 25.0}),
    ],
    ids=["robot", "joints", "fleet", "scenario"],
)
def test_a_batch_equals_single_environments(
    gymnasium: Any, file: Path, options: dict[str, Any]
) -> None:
    envs = list(both(gymnasium, file, duration=0.9, **options))
    for name in ("single_observation_space", "single_action_space", "observation_space"):
        assert getattr(envs[0], name) == getattr(envs[1], name)
    assert envs[0].metadata == envs[1].metadata
    results = play(envs, 25)
    assert any(truncated.all() for _, _, _, truncated, _ in results)


def test_faults_zones_and_noise_are_those_of_each_environment(
    gymnasium: Any, scenario: Path
) -> None:
    """One environment starts earlier than the others, so that its faults do too."""
    envs = list(both(gymnasium, scenario))
    play(envs, 7)
    first = np.array([True, False, False])
    equal(*[env.reset(seed=3, options={"reset_mask": first.copy()}) for env in envs], where="mask")
    rewards = []
    for count in range(30):
        action = np.full((NUMBER, 3), (1.0, 0.0, 0.1), dtype=np.float32)
        batched, single = (env.step(action) for env in envs)
        equal(batched[0], single[0], f"step {count}")
        equal(batched[4], single[4], f"step {count}")
        rewards.append(single[1])
    assert min(np.ravel(rewards)) < -0.5  # a collision


@pytest.mark.parametrize("mode", ["SAME_STEP", "DISABLED"])
def test_autoreset_is_that_of_gymnasium(gymnasium: Any, mode: str) -> None:
    autoreset_mode = gymnasium.vector.AutoresetMode[mode]
    envs = list(both(gymnasium, SLIM, duration=0.3, autoreset_mode=autoreset_mode))
    assert envs[0].metadata["autoreset_mode"] is autoreset_mode
    results = play(envs, 3)
    assert ("final_obs" in results[-1][4]) == (mode == "SAME_STEP")
    if mode == "DISABLED":
        with pytest.raises(AssertionError):
            envs[0].step(np.zeros((NUMBER, 3), dtype=np.float32))
    play(envs, 3)


def test_seeds_are_those_of_single_environments(gymnasium: Any) -> None:
    envs = gymnasium.make_vec(environments.NAME, NUMBER, file=str(SLIM), spread=(1.0, 1.0, 3.0))
    assert isinstance(envs.unwrapped, RobotVectorEnv)
    observations, info = envs.reset(seed=20)
    for i in range(NUMBER):
        single = environments.make(SLIM, spread=(1.0, 1.0, 3.0))
        observation, single_info = single.reset(seed=20 + i)
        assert (observation == observations[i]).all()
        assert (single_info["true_pose"] == info["true_pose"][i]).all()
    assert len(np.unique(observations[:, 3])) == NUMBER


def test_one_diverged_environment_does_not_disturb_the_others(
    gymnasium: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    envs = list(both(gymnasium, SLIM))
    action = np.full((NUMBER, 3), 0.3, dtype=np.float32)
    for env in envs:
        env.reset(seed=4)
        env.step(action)
        env.envs[1].unwrapped.scene.data.qvel[:] = 1e7
    batched, single = (env.step(action) for env in envs)
    assert list(batched[2]) == [False, True, False]
    assert batched[4]["cause"][1] == "diverged"
    equal(batched[0], single[0], "observation")
    batched, single = (env.step(action) for env in envs)
    equal(batched[0], single[0], "after the reset")
    assert not any(batched[2])
    assert list(tmp_path.iterdir()) == []  # no log file of MuJoCo
    assert capfd.readouterr() == ("", "")


def test_the_number_of_threads_does_not_change_the_results(gymnasium: Any) -> None:
    envs = [environments.make_batch(SLIM, NUMBER, threads=threads) for threads in (1, 3)]
    play(envs, 3)


def test_wrong_actions_change_nothing(gymnasium: Any) -> None:
    envs = list(both(gymnasium, SLIM))
    for env in envs:
        env.reset(seed=1)
    actions = np.full((NUMBER, 3), 0.4, dtype=np.float32)
    for wrong in (actions[:, :2], actions * [[1.0], [1.0], [np.nan]]):
        with pytest.raises(ValueError, match="finite numbers"):
            envs[0].step(wrong)
    equal(*[env.step(actions) for env in envs], where="step")


def test_worlds_advance_only_together() -> None:
    model = compile_file(SLIM).model
    assert model is not None
    physics = MujocoPhysics(MujocoScene(emit(model, ["mjcf"])), 2, own_models=False, threads=1)
    worlds = [World(physics, number) for number in range(2)]
    with pytest.raises(RuntimeError, match="advance_all"):
        worlds[1].step_to(0.02)


def test_wrong_arguments_are_errors(scenario: Path) -> None:
    for options in ({"physics": "bullet"}, {"num_envs": 0}, {"threads": -1}, {"rate": 0.0}):
        with pytest.raises(ValueError, match="must"):
            environments.make_batch(SLIM, **options)
    for options in ({"device": "cpu"}, {"physics": "warp", "threads": 2}):
        with pytest.raises(ValueError, match="`threads` is for"):
            environments.make_batch(SLIM, **options)
    with pytest.raises(ValueError, match=r"no\s+faults"):
        environments.make_batch(scenario, 2, physics="warp")
    with pytest.raises(ValueError, match="one rate for all drivers"):
        environments.make_batch(with_rate(scenario.parent, 30.0), 2, physics="warp")


def with_rate(folder: Path, rate: float) -> Path:
    """A robot whose driver has a period that is no whole number of simulation steps."""
    path = folder / "robot.yaml"
    text = SLIM.read_text(encoding="utf-8")
    assert "driver:" not in text
    path.write_text(f"{text}\ndriver: {{rate: {rate} Hz}}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("module", "physics", "message"),
    [
        ("mujoco.batch", "mujoco", "the batch needs MuJoCo 3.17 or newer, and MuJoCo"),
        ("mujoco_warp", "warp", "MuJoCo Warp is not installed"),
    ],
)
def test_a_missing_package_is_an_error_with_its_extra(
    monkeypatch: pytest.MonkeyPatch, module: str, physics: str, message: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=message) as caught:
        environments.make_batch(SLIM, 2, physics=physics)
    assert install_command("batch" if physics == "mujoco" else "warp") in str(caught.value)
