"""A public implementation of PPO (stable-baselines3) learns to drive to a goal.

    pip install stable-baselines3
    python -m bench learning

The policy sees the goal in the frame of the odometry, and the measured twist.  Its twists pass
through the base driver with its limits and ramps.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

from bench.figure import EXAMPLE, Figure
from thorvaldc.tools.gym import environments
from thorvaldc.tools.gym.robot_env import RobotEnv, Transition

GROUP = "long"

GOAL = (2.0, 0.5)
"""x and y in the scene, m."""
NEAR = 0.25
"""Distance (m) at which the goal is reached."""
FAR = 5.0
"""Largest component (m) of the observed distance."""
SPREAD = (1.0, 1.0, 1.5)
ENVIRONMENTS, STEPS, TRIALS, SEED = 4, 20_000, 50, 1


def figures() -> Iterator[Figure]:
    try:
        from stable_baselines3 import PPO
        from stable_baselines3.common.env_checker import check_env
        from stable_baselines3.common.env_util import make_vec_env
    except ImportError:
        print("stable-baselines3 is not installed, so PPO is left out", file=sys.stderr)
        return
    check_env(environment(), skip_render_check=True)
    envs = make_vec_env(environment, ENVIRONMENTS, seed=SEED)
    settings = {"n_steps": 128, "batch_size": 64, "gamma": 0.95, "learning_rate": 1e-3}
    policy = PPO("MlpPolicy", envs, seed=SEED, device="cpu", **settings)
    before = reached(policy)
    policy.learn(STEPS)
    how = (
        f"% of {TRIALS} start poses from which the goal is reached within 10 s, after {STEPS:,}"
        f" steps of PPO with {ENVIRONMENTS} environments of a 4WD4WS; {before:g} before"
    )
    yield Figure("PPO: goals reached", reached(policy), "%", 95.0, "higher", how)


def environment() -> Any:
    """Returns an environment in which the robot is to drive to ``GOAL``."""
    high = np.array([FAR, FAR, 3.0, 3.0, 3.0], np.float32)
    return gymnasium.make(
        environments.NAME,
        file=EXAMPLE,
        rate=5,
        duration=10,
        spread=SPREAD,
        reward=_gain,
        terminates=lambda step: _distance(step.after.pose_true) < NEAR,
        observe=_observe,
        observation_space=gymnasium.spaces.Box(-high, high),
    )


def _distance(pose: Any) -> float:
    return math.hypot(GOAL[0] - pose[0], GOAL[1] - pose[1])


def _gain(step: Transition) -> float:
    """Returns the distance (m) by which a step came closer, and 1 at the goal."""
    before, after = _distance(step.before.pose_true), _distance(step.after.pose_true)
    return before - after + float(after < NEAR)


def _observe(env: RobotEnv) -> Any:
    """Returns the goal in the frame of the odometry (m) and the measured twist."""
    sample = env.episode.sample(env.name)
    x, y, yaw = sample.pose_estimated
    dx, dy = GOAL[0] - x, GOAL[1] - y
    ahead = math.cos(yaw) * dx + math.sin(yaw) * dy
    left = math.cos(yaw) * dy - math.sin(yaw) * dx
    row = [*np.clip([ahead, left], -FAR, FAR), *np.clip(sample.estimated, -3.0, 3.0)]
    return np.array(row, np.float32)


def reached(policy: Any) -> float:
    """Returns the percentage of start poses from which the policy reaches the goal."""
    env, number = environment(), 0
    for trial in range(TRIALS):
        observation, _ = env.reset(seed=10_000 + trial)
        terminated = truncated = False
        while not terminated and not truncated:
            action, _ = policy.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
        number += info["cause"] == "ended"
    env.close()
    return 100.0 * number / TRIALS
