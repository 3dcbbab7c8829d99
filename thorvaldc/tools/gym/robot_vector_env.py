"""Many environments of one robot, whose physics advances in one batch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium.vector import SyncVectorEnv
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import Scenario
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.tools.gym.batch_physics import (
    BatchPhysics,
    MujocoPhysics,
    WarpPhysics,
    World,
    advance_all,
)
from thorvaldc.tools.gym.robot_env import Array, RobotEnv, Step, prepare_drawing

PHYSICS = ("mujoco", "warp")


class _Environment(RobotEnv):
    """An environment whose steps ``RobotVectorEnv`` has run before ``step``.

    ``is_over``: the episode has ended, or has not begun.
    """

    is_over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        result = super().reset(seed=seed, options=options)
        self.is_over = False
        return result

    def step(self, action: NDArray[np.float32]) -> Step:
        result = self.finish_step()
        self.is_over = result[2] or result[3]
        return result


class RobotVectorEnv(SyncVectorEnv):
    """Environments ``RobotEnv`` that step together; the physics of all is one batch.

    It is Gymnasium's ``SyncVectorEnv`` in everything but the physics: spaces, seeds, autoreset,
    ``info``, ``call`` and ``get_attr``.  The driver of each robot runs in Python, one after the
    other.
    """

    def __init__(
        self,
        model: Robot | Fleet | Scenario,
        files: Path | str | Mapping[str, bytes],
        num_envs: int = 1,
        *,
        physics: str = "mujoco",
        threads: int = 0,
        device: str | None = None,
        autoreset_mode: Any = None,
        **options: Any,
    ) -> None:
        """Loads the MuJoCo scene once, and creates the environments.

        * ``num_envs``: number of environments.
        * ``physics``: ``mujoco`` for ``mujoco.batch`` on the CPU, ``warp`` for MuJoCo Warp.
        * ``threads``: number of threads of ``mujoco``; 0 for one on each processor.
        * ``device``: device of ``warp``, such as ``cuda:0`` or ``cpu``; by default the one that
          Warp prefers.
        * ``autoreset_mode``: an ``AutoresetMode`` of Gymnasium, by default ``NEXT_STEP``.
        * ``options``: keyword arguments of ``RobotEnv``.

        Raises ``ImportError`` if MuJoCo is older than 3.17, or if MuJoCo Warp is not installed.
        Raises ``ValueError`` if an argument is invalid or is for the other physics, or if the
        physics cannot simulate the scenario.
        """
        if physics not in PHYSICS:
            raise ValueError(f"the physics is {physics!r}; it must be {' or '.join(PHYSICS)}")
        if num_envs < 1 or threads < 0:
            raise ValueError("num_envs must be positive, and threads must not be negative")
        if (physics == "mujoco" and device is not None) or (physics == "warp" and threads):
            raise ValueError("`threads` is for the physics `mujoco`, and `device` for `warp`")
        prepare_drawing(options.get("render_mode"))
        start = MujocoScene(files)
        self.physics: BatchPhysics
        if physics == "warp":
            _check_for_warp(model, start)
            self.physics = WarpPhysics(start, num_envs, device)
        else:
            own_models = isinstance(model, Scenario)
            self.physics = MujocoPhysics(start, num_envs, own_models, threads)

        def environment(number: int) -> _Environment:
            return _Environment(model, files, scene=World(self.physics, number), **options)

        super().__init__(
            [partial(environment, number) for number in range(num_envs)],
            **({} if autoreset_mode is None else {"autoreset_mode": autoreset_mode}),
        )

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        if np.shape(actions) != self.action_space.shape or not np.isfinite(actions).all():
            raise ValueError(f"the actions must be {self.action_space.shape} finite numbers")
        environments = [env for env in self.envs if isinstance(env, _Environment)]
        commanded = []
        for env, action in zip(environments, iterate(self.action_space, actions), strict=True):
            if not env.is_over:
                env.start_step(action)
                commanded.append(env)
        while ticks := [(env, loop) for env in commanded if (loop := env.due())]:
            advance_all(self.physics, {cast(World, e.scene): loop.next_time for e, loop in ticks})
            for env, loop in ticks:
                env.episode.tick(loop)
        return super().step(actions)


def _check_for_warp(model: Robot | Fleet | Scenario, scene: MujocoScene) -> None:
    """Raises ``ValueError`` if worlds would need models or numbers of steps of their own."""
    if isinstance(model, Scenario):
        world = model.fleet.world
        if model.faults or model.open_loop or (world is not None and world.zones):
            raise ValueError(
                "the physics `warp` has one model for all environments: a scenario must have no"
                " faults, no zones and no open loop"
            )
    fleet = model.fleet if isinstance(model, Scenario) else model
    robots = [p.robot for p in fleet.placements] if isinstance(fleet, Fleet) else [fleet]
    rates = {robot.driver.rate for robot in robots}
    steps = 1.0 / (min(rates) * scene.timestep)
    if len(rates) > 1 or not math.isclose(steps, round(steps)):
        raise ValueError(
            "the physics `warp` needs one rate for all drivers, with a whole number of simulation"
            f" steps of {scene.timestep:g} s in a period"
        )
