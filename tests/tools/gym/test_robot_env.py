"""Environments: Gymnasium's checker, repeatability, ends of episodes, errors."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from tests.cli.conftest import UNPOWERED
from tests.outside_tools import require
from tests.slow import mostly_slow
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.simulation.pictures import render
from thorvaldc.tools.gym import environments
from thorvaldc.tools.gym.robot_env import RobotEnv

ROOT = Path(__file__).resolve().parents[3]
SLIM = ROOT / "examples/4wd4ws_slim/robot.yaml"
TALL = ROOT / "examples/4wd2ws_tall/robot.yaml"
CART = ROOT / "examples/2wd0ws_greenhouse/robot.yaml"
FIELD = ROOT / "examples/scenarios/field_edge.yaml"


@pytest.fixture(scope="module")
def gymnasium() -> Any:
    import gymnasium

    return gymnasium


@pytest.fixture
def draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chooses an OpenGL backend for the test; skips the test if there is none."""
    require("OpenGL")
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", ""))
    render.choose_opengl_backend()


def environment(gymnasium: Any, file: Path, **options: Any) -> Any:
    return gymnasium.make(environments.NAME, file=str(file), **options)


@pytest.mark.usefixtures("draws")
@pytest.mark.parametrize(
    ("file", "action"),
    [
        (TALL, "joints"),
        (FIELD, "twist"),
        pytest.param(TALL, "twist", marks=pytest.mark.exhaustive),
        pytest.param(FIELD, "joints", marks=pytest.mark.exhaustive),
        pytest.param(CART, "twist", marks=pytest.mark.exhaustive),
        pytest.param(CART, "joints", marks=pytest.mark.exhaustive),
    ],
)
def test_gymnasium_checker_passes(gymnasium: Any, file: Path, action: str) -> None:
    from gymnasium.utils.env_checker import check_env

    env = environment(gymnasium, file, action=action, spread=(0.1, 0.1, 0.2))
    check_env(env.unwrapped)  # its warnings are errors in the tests
    env.close()


def test_a_twist_moves_the_robot_and_its_odometry(gymnasium: Any) -> None:
    env = environment(gymnasium, SLIM, duration=3.0).unwrapped
    limit = env.robot.driver.max_linear_velocity
    env.reset(seed=1)
    for count in range(1, 31):
        observation, reward, terminated, truncated, info = env.step(
            np.array([0.8 / limit, 0.0, 0.0])
        )
        assert reward == 0.0
        assert not terminated
        assert truncated == (count == 30)
    assert info["cause"] == "time"
    assert info["time"] == pytest.approx(3.0)
    values = dict(zip(env.observation_names, observation, strict=True))
    assert values["vx"] == pytest.approx(0.8, abs=0.02)
    assert values["x"] == pytest.approx(info["true_pose"][0], abs=0.02)
    assert 1.5 < values["x"] < 2.4
    assert values["fl_wheel_speed"] == pytest.approx(0.8 / env.robot.wheels[0].radius, rel=0.03)


def test_joints_follow_their_actions(gymnasium: Any) -> None:
    env = environment(gymnasium, TALL, action="joints", rate=5.0).unwrapped
    env.reset(seed=1)
    motor = env.robot.actuator_of(env.robot.wheels[0].spin_joint)
    turned = 0.5
    scale = math.pi / 2
    joint = env.robot.joint(env.robot.wheels[0].steering_joint)
    if joint.upper is not None:
        scale = max(abs(joint.lower), joint.upper)
    action = np.array([0.1] * 4 + [turned / scale, -1.0], dtype=np.float32)
    for _ in range(10):
        observation, *_, info = env.step(action)
    values = dict(zip(env.observation_names, observation, strict=True))
    assert values["rl_wheel_speed"] == pytest.approx(0.1 * motor.max_velocity, rel=0.05)
    assert values["fl_wheel_angle"] == pytest.approx(turned, abs=0.02)
    assert values["fr_wheel_angle"] == pytest.approx(-scale, abs=0.05)
    assert abs(info["true_pose"]).max() > 0.1
    with pytest.raises(ValueError, match="finite numbers"):
        env.step(np.array([math.nan] * 6))
    # A new episode does not continue the commands of the last one.
    env.reset(seed=1)
    command = env.episode.loops[env.name].driver.state.command
    assert command is not None
    assert set(command.joints.speeds) == {0.0}


def test_steering_stays_within_its_limits(gymnasium: Any) -> None:
    """The angles jump from one limit to the other, as an untrained policy commands."""
    env = environment(gymnasium, SLIM, action="joints").unwrapped
    joint = env.robot.joint(env.robot.wheels[0].steering_joint)
    env.reset(seed=1)
    largest = 0.0
    for step in range(80):
        side = 1.0 if (step // 20) % 2 else -1.0
        observation, *_ = env.step(np.array([0.2] * 4 + [side] * 4))
        largest = max(largest, np.abs(observation[-4:]).max())
    assert largest == pytest.approx(joint.upper, abs=0.01)


def test_bounds_are_those_of_the_robot(gymnasium: Any) -> None:
    env = environment(gymnasium, SLIM, duration=10.0, spread=(1, 2, 0.5)).unwrapped
    bounds = dict(zip(env.observation_names, env.observation_space.high, strict=True))
    assert (env.observation_space.low == -env.observation_space.high).all()
    wheel = env.robot.wheels[0]
    motor = env.robot.actuator_of(wheel.spin_joint)
    assert bounds["fl_wheel_speed"] == pytest.approx(1.5 * motor.max_velocity)
    assert 1.0 < bounds["vx"] / (wheel.radius * motor.max_velocity) < 2.0
    assert bounds["x"] == pytest.approx(math.hypot(1, 2) + 10.0 * bounds["vx"])
    assert bounds["fl_wheel_angle"] < math.pi + 0.1
    # Joints that work against each other stay within the bounds, and contradictory twists are
    # clipped.
    env = environment(gymnasium, SLIM, action="joints", duration=10.0).unwrapped
    env.reset(seed=1)
    rng = np.random.default_rng(1)
    for step in range(100):
        if step % 10 == 0:
            action = np.sign(rng.uniform(-1, 1, env.action_space.shape))
        observation, *_ = env.step(action)
        assert (np.abs(observation) <= env.observation_space.high).all()
        assert (np.abs(observation) < env.observation_space.high)[6:].all()


@pytest.mark.parametrize("seed", mostly_slow((1, 2, 3), slow=0))
def test_the_policy_of_the_page_reaches_its_goal_from_every_start(
    gymnasium: Any, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    page = (ROOT / "docs/batches.md").read_text(encoding="utf-8")
    section = page.partition("## Gymnasium environment")[2]
    program = section.partition("```python\n")[2].partition("```")[0]
    monkeypatch.chdir(ROOT)
    values: dict[str, Any] = {}
    exec(program.replace("seed=1", f"seed={seed}"), values)
    assert values["info"]["true_pose"][:2] == pytest.approx([3.0, 1.0], abs=0.1)


def episode(env: Any, seed: int, steps: int = 5) -> list[Any]:
    observation = [env.reset(seed=seed)[0]]
    rng = np.random.default_rng(3)
    actions = rng.uniform(-1, 1, (steps, 3)).astype(np.float32)
    return [*observation, *(env.step(action)[0] for action in actions)]


def test_random_numbers_depend_only_on_the_seed(gymnasium: Any) -> None:
    env = environment(gymnasium, FIELD, spread=(0.3, 0.3, 0.5)).unwrapped
    first, second = episode(env, 7), episode(env, 7)
    other = episode(environment(gymnasium, FIELD, spread=(0.3, 0.3, 0.5)).unwrapped, 7)
    for a, b, c in zip(first, second, other, strict=True):
        assert (a == b).all()
        assert (a == c).all()
    # Another seed changes the start and the noise.
    assert any((a != b).any() for a, b in zip(first, episode(env, 8), strict=True))


def test_an_option_sets_the_start_offset(gymnasium: Any) -> None:
    env = environment(gymnasium, SLIM, spread=(1.0, 1.0, 3.0)).unwrapped
    observation, info = env.reset(seed=1, options={"offset": (0.5, -0.25, 1.0)})
    assert info["true_pose"] == pytest.approx([0.5, -0.25, 1.0], abs=1e-9)
    assert observation[3:6] == pytest.approx([0.5, -0.25, 1.0], abs=1e-6)
    observation, _, _, _, info = env.step(np.array([0.5, 0.0, 0.0]))
    moved = info["true_pose"] - [0.5, -0.25, 1.0]
    assert math.atan2(moved[1], moved[0]) == pytest.approx(1.0, abs=0.05)
    starts = [env.reset(seed=seed)[1]["true_pose"] for seed in range(20)]
    assert np.ptp(starts, axis=0)[0] > 0.5
    assert (np.abs(starts) <= [1.0, 1.0, 3.0]).all()


def test_a_reward_function_gets_the_step(gymnasium: Any) -> None:
    seen = []

    def forward(step: Any) -> float:
        seen.append(step)
        return float(step.after.pose_true.x - step.before.pose_true.x)

    env = environment(gymnasium, SLIM, reward=forward).unwrapped
    env.reset(seed=1)
    total = sum(env.step(np.array([0.5, 0.0, 0.0]))[1] for _ in range(10))
    assert total == pytest.approx(env.step(np.zeros(3))[4]["true_pose"][0], abs=0.2)
    assert total > 0.2
    assert seen[0].duration == pytest.approx(0.1)
    assert seen[0].collisions == 0


def test_tip_over_and_divergence_terminate_an_episode(gymnasium: Any) -> None:
    env = environment(gymnasium, TALL).unwrapped
    env.reset(seed=1)
    env.scene.model.opt.gravity[:] = (0.0, 12.0, -3.0)
    for _ in range(50):
        *_, terminated, truncated, info = env.step(np.zeros(3))
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["cause"] == "tipped"
    env.scene.model.opt.gravity[:] = (0.0, 0.0, -9.81)
    _, info = env.reset(seed=1)
    assert info["tilt"] < 0.01
    env.scene.data.qvel[:] = 1e7
    observation, reward, terminated, _, info = env.step(np.zeros(3))
    assert terminated
    assert info["cause"] == "diverged"
    assert env.observation_space.contains(observation)
    assert math.isfinite(reward)


def test_injected_faults_end_between_episodes(gymnasium: Any) -> None:
    env = environment(gymnasium, FIELD).unwrapped
    before = env.scene.model.geom_friction.copy()
    env.reset(seed=1)
    for _ in range(75):
        env.step(np.zeros(3))
    assert (env.scene.model.geom_friction != before).any()
    env.reset(seed=1)
    assert (env.scene.model.geom_friction == before).all()


RANDOM = {
    "world.friction": (0.3, 0.8),
    "faults.0.until": ["9 s", "11 s"],
    "modules.frame.params.width": ("1.4 m", "1.6 m"),
    "noise.wheel_speed": lambda random: random.normal(0.02, 0.001),
}


@pytest.mark.slow
def test_each_reset_draws_another_robot_and_another_world(gymnasium: Any) -> None:
    """The values follow from the seed, and the robot that drives is the one with the values."""
    env = environment(gymnasium, FIELD, randomize=RANDOM).unwrapped
    drawn = []
    for seed in (1, 2, 1):
        _, info = env.reset(seed=seed)
        drawn.append(info["values"])
        compilation = compile_file(FIELD, set=info["values"])
        assert compilation.scenario is not None
        assert env.robot == compilation.scenario.fleet.placements[0].robot
        assert env.episode.scenario == compilation.scenario
        assert 0.3 <= info["values"]["world.friction"] <= 0.8
        assert info["values"]["faults.0.until"] in ("9 s", "11 s")
    assert drawn[0] == drawn[2] != drawn[1]
    plain = environment(gymnasium, SLIM).unwrapped
    plain.reset(seed=1)
    width = plain.robot.wheels[0].y
    plain.reset(seed=1, options={"set": {"modules.frame.params.width": "1.2 m"}})
    assert plain.robot.wheels[0].y > width
    assert "values" not in plain.reset(seed=1)[1]
    assert plain.robot.wheels[0].y == width
    longer = environment(gymnasium, FIELD, randomize={"duration": ["5 s"]}).unwrapped
    longer.reset(seed=1)
    assert longer.duration == 5.0
    _, info = env.reset(seed=1, options={"set": {"world.friction": 0.5}})
    assert info["values"] == {**drawn[0], "world.friction": 0.5}
    observation = env.step(np.ones(3))[0]
    assert env.observation_space.contains(observation)


@pytest.mark.slow
def test_values_that_no_environment_can_have(gymnasium: Any, tmp_path: Path) -> None:
    for randomize, message in (
        ({"world.friction": (0.8, 0.3)}, "no range of `world.friction`"),
        ({"world.friction": (0.3, 0.5, 0.8)}, "no range of `world.friction`"),
        ({"world.friction": 0.8}, "no range of `world.friction`"),
        ({"world.friction": "12"}, "no range of `world.friction`"),
        ({"world.friction": []}, "no range of `world.friction`"),
    ):
        with pytest.raises(ValueError, match=message):
            environment(gymnasium, FIELD, randomize=randomize)
    env = environment(gymnasium, SLIM, randomize={"driver.rat": [1]}).unwrapped
    with pytest.raises(ValueError, match=r"driver\.rat: error"):
        env.reset(seed=1)
    (tmp_path / "good.yaml").write_text(UNPOWERED)
    removed = {"modules.rl.type": ["none"]}
    env = environment(gymnasium, tmp_path / "good.yaml", randomize=removed).unwrapped
    with pytest.raises(ValueError, match=r"the wheels of .* are others"):
        env.reset(seed=1)
    with pytest.raises(ValueError, match="a batch has one model"):
        gymnasium.make_vec(environments.NAME, 2, file=str(SLIM), randomize={"name": ["a"]})
    for options in ({"offset": (math.nan, 0.0, 0.0)}, {"offset": 5}, {"set": 5}):
        with pytest.raises(ValueError, match="it must be"):
            environment(gymnasium, SLIM).unwrapped.reset(options=options)
    plain = RobotEnv(compile_file(SLIM).model)
    with pytest.raises(ValueError, match="new values need a file"):
        plain.reset(options={"set": {"driver.rate": "50 Hz"}})


@pytest.mark.slow
def test_the_checker_passes_with_other_robots(gymnasium: Any) -> None:
    from gymnasium.utils.env_checker import check_env

    width = {"modules.frame.params.width": ("1.4 m", "1.6 m")}
    env = environment(gymnasium, SLIM, randomize=width)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()
    envs = gymnasium.make_vec(
        environments.NAME, 2, vectorization_mode="sync", file=str(SLIM), randomize=width
    )
    _, info = envs.reset(seed=[3, 4])
    first, second = info["values"]["modules.frame.params.width"]
    assert first != second
    envs.close()


@pytest.mark.parametrize("mode", mostly_slow(["sync", "async"]))
def test_several_environments(gymnasium: Any, mode: str) -> None:
    # A forked process would inherit the locks of the threads that numpy and MuJoCo have here.
    processes = {"vector_kwargs": {"context": "spawn"}} if mode == "async" else {}
    envs = gymnasium.make_vec(
        f"thorvaldc.tools.gym.environments:{environments.NAME}",
        2,
        vectorization_mode=mode,
        file=str(SLIM),
        spread=(0.1, 0.1, 0.1),
        **processes,
    )
    try:
        observation, info = envs.reset(seed=[3, 4])
        assert observation.shape == (2, len(info["true_pose"][0]) + 11)
        assert (info["true_pose"][0] != info["true_pose"][1]).any()
        for _ in range(3):
            moved, rewards, *_ = envs.step(np.full((2, 3), 0.4, dtype=np.float32))
        assert (moved[:, 3] > observation[:, 3] + 0.001).all()
        assert rewards.shape == (2,)
    finally:
        envs.close()


@pytest.mark.usefixtures("draws")
def test_pictures_follow_the_robot(gymnasium: Any) -> None:
    env = environment(gymnasium, SLIM, render_mode="rgb_array", size=(160, 90)).unwrapped
    env.reset(seed=1)
    first = env.render()
    assert first.shape == (90, 160, 3)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 50
    for _ in range(5):
        env.step(np.array([1.0, 0.0, 1.0]))
    assert (env.render() != first).any()
    env.close()
    assert environment(gymnasium, SLIM).unwrapped.render() is None


def test_an_environment_of_a_build_or_of_compiled_files(gymnasium: Any) -> None:
    from thorvaldc.tools.gym.robot_env import RobotEnv

    model = compile_file(SLIM).model
    assert model is not None
    env = RobotEnv(model, emit(model, ["mjcf"]))  # type: ignore[arg-type]
    assert env.reset(seed=1)[0].shape == env.observation_space.shape
    fleet = compile_file(ROOT / "examples/fleet_of_four/fleet.yaml").model
    assert fleet is not None
    second = RobotEnv(fleet, emit(fleet, ["mjcf"]), robot="six", action="joints")
    assert second.action_space.shape == (12,)


def test_wrong_arguments_are_errors(gymnasium: Any, tmp_path: Path) -> None:
    for options in (
        {"action": "torque"},
        {"rate": 0.0},
        {"duration": -1.0},
        {"spread": (1.0, 1.0)},
        {"robot": "none"},
    ):
        with pytest.raises(ValueError, match=r"must|spread|there is no robot"):
            environments.make(SLIM, **options)
    with pytest.raises(ValueError, match=r"is not a scenario"):
        environments.make(SLIM, scenario=TALL)
    wrong = tmp_path / "robot.yaml"
    wrong.write_text("thorvaldc: 1\nname: x\nmodules: {frame: {type: no/ne}}\n")
    with pytest.raises(ValueError, match=r"robot\.yaml:3:\d+.*TV301"):
        environments.make(wrong)
    replaced = environments.make(TALL, scenario=FIELD)
    assert (replaced.name, len(replaced.robot.wheels)) == ("thorvald", 4)


def test_gymnasium_makes_the_environment_by_its_module() -> None:
    """In a process that has not imported thorvaldc."""
    program = (
        "import gymnasium\n"
        "name = 'thorvaldc.tools.gym.environments:thorvaldc/Robot-v0'\n"
        f"env = gymnasium.make(name, file={str(SLIM)!r})\n"
        "print(env.reset(seed=1)[0].shape, env.spec.id)\n"
        "import thorvaldc.tools.gym.environments\n"
        "gymnasium.register_envs(thorvaldc.tools.gym.environments)\n"
        f"gymnasium.make('thorvaldc/Robot-v0', file={str(SLIM)!r})\n"
    )
    process = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": ":".join(p for p in sys.path if p)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.stderr == ""
    assert process.stdout == "(14,) thorvaldc/Robot-v0\n"


@pytest.mark.parametrize("module", mostly_slow(["environments", "robot_env"], slow=0))
def test_without_gymnasium_the_error_names_the_extra(module: str) -> None:
    program = f"import sys; sys.modules['gymnasium'] = None; import thorvaldc.tools.gym.{module}"
    process = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": ":".join(p for p in sys.path if p)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 1
    last = process.stderr.strip().splitlines()[-1]
    assert last.startswith("ImportError: an environment needs Gymnasium")
    assert install_command("gym") in last


def ranges(env: Any) -> Any:
    """The distances (m) of the front lidar; 0 before its first message."""
    message = env.episode.sensors["thorvald/lidar_front"].latest
    if message is None:
        return np.zeros(SPACE.shape, dtype=np.float32)
    return np.clip(np.asarray(message.ranges, dtype=np.float32), 0.0, 30.0)


SPACE = spaces.Box(0.0, 30.0, (541,), np.float32)


@pytest.mark.slow
def test_an_own_observation_is_that_of_a_sensor(gymnasium: Any) -> None:
    from gymnasium.utils.env_checker import check_env

    options = {"observe": ranges, "observation_space": SPACE}
    env = environment(gymnasium, FIELD, **options)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=1)
    for _ in range(3):
        observation = env.step(np.zeros(3))[0]
    assert observation.shape == SPACE.shape
    assert 0.1 < observation.min() < 29.0  # posts stand along the field
    with pytest.raises(ValueError, match="`observe` needs"):
        environment(gymnasium, FIELD, observe=ranges)
    with pytest.raises(DiagnosticError, match="a world of a batch has no sensors"):
        gymnasium.make_vec(environments.NAME, 2, file=str(FIELD), **options).reset(seed=1)


def test_an_own_function_ends_the_episode_at_a_goal(gymnasium: Any) -> None:
    env = environment(
        gymnasium,
        SLIM,
        terminates=lambda step: step.after.pose_true.x > 0.3,
        reward=lambda step: 10.0 if step.terminated else -1.0,
    ).unwrapped
    env.reset(seed=1)
    rewards: list[float] = []
    terminated = False
    while not terminated:
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0, 0.0]))
        rewards.append(reward)
        assert not truncated
    assert info["cause"] == "ended"
    assert info["true_pose"][0] > 0.3
    assert rewards[-1] == 10.0
    assert set(rewards[:-1]) == {-1.0}
