"""Many open-loop runs of one robot at once, on threads: for planning and identification.

No driver and no odometry: joint commands in, the truth out, by ``mujoco.rollout``.  What
needs the driver, faults or noise is a batch of scenarios.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

Array = NDArray[np.float64]
_ROOM = 1 << 23
"""Numbers of MuJoCo's states that are kept at a time."""


@dataclass(frozen=True, slots=True)
class Trajectories:
    """n runs at the ends of t ticks; a run that diverged is NaN from then on.

    ``time`` (t,) in s; ``poses`` (n, t, 3): x, y, yaw (not wrapped) of ``base_link`` in the
    scene; ``twists`` (n, t, 3): its vx, vy, wz in itself; ``uprightness`` (n, t): cosine of the
    tilt; ``speeds``, ``angles`` (n, t, wheels): rad/s of the spin and rad of the steering
    joints.  ``states`` (n, state) are MuJoCo's at the end, to go on from.
    """

    time: Array
    poses: Array
    twists: Array
    uprightness: Array
    speeds: Array
    angles: Array
    states: Array


class Rollouts:
    """A robot alone in its scene, ready to run many times."""

    def __init__(
        self, robot: Robot, files: Path | str | Mapping[str, bytes], threads: int = 1
    ) -> None:
        """``files`` as of ``MujocoScene``.  Raises ``DiagnosticError``."""
        import mujoco
        from mujoco.rollout import Rollout

        if threads < 1:
            raise ValueError(f"there are {threads} threads; there must be at least one")
        self.robot = robot
        self.scene = MujocoScene(files)
        self._joints = _Joints(robot, self.scene)
        model = self.scene.model
        self._physics = mujoco.mjtState.mjSTATE_FULLPHYSICS
        start = np.empty(mujoco.mj_stateSize(model, self._physics))
        mujoco.mj_getState(model, self.scene.data, start, self._physics)
        self.start: Array = start
        """MuJoCo's state of the robot at rest at home."""
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._rollout = Rollout(nthread=threads)
        self._home = self.scene.data.ctrl.copy()

    def at(self, poses: ArrayLike) -> Array:
        """States (n, state) of the robot at rest at ``poses`` (n, 3): x, y in m, yaw in rad."""
        wanted = np.atleast_2d(np.asarray(poses, dtype=np.float64))
        states = np.repeat(self.start[None], len(wanted), axis=0)
        first = 1 + self._joints.base
        w, i, j, k = self.start[first + 3 : first + 7]
        half = wanted[:, 2] / 2.0
        c, s = np.cos(half), np.sin(half)
        states[:, first : first + 2] = wanted[:, :2]
        turned = np.stack([c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w], axis=1)
        states[:, first + 3 : first + 7] = turned
        return states

    def run(
        self,
        speeds: ArrayLike,
        angles: ArrayLike | None = None,
        *,
        period: float = 0.1,
        states: Array | None = None,
    ) -> Trajectories:
        """Run ``speeds`` (rad/s) and ``angles`` (rad), each (n, t, wheels), from ``states``.

        Commands hold for ``period`` s each, a whole number of the scene's steps; entries of
        wheels without such a motor are not looked at.  ``states``: (n, state), by default all
        at ``start``.  The result does not depend on the number of threads.
        """
        asked = np.asarray(speeds, dtype=np.float64)
        turned = np.zeros_like(asked) if angles is None else np.asarray(angles, dtype=np.float64)
        steps = round(period / self.scene.timestep)
        if asked.ndim != 3 or asked.shape[2] != len(self.robot.wheels):
            raise ValueError(f"speeds are (n, t, {len(self.robot.wheels)}), not {asked.shape}")
        if turned.shape != asked.shape:
            raise ValueError(f"angles are {turned.shape}, and speeds {asked.shape}")
        if steps < 1 or not math.isclose(steps * self.scene.timestep, period, rel_tol=1e-6):
            raise ValueError(
                f"a period of {period:g} s is no whole number of {self.scene.timestep:g} s"
            )
        n, ticks, _ = asked.shape
        control = self._joints.control(self._home, asked, turned)
        now = np.repeat(self.start[None], n, axis=0) if states is None else np.array(states)
        if now.shape != (n, len(self.start)):
            raise ValueError(f"states are {now.shape}; they must be {(n, len(self.start))}")
        found = np.empty((n, ticks, len(self.start)))
        at_once = max(1, _ROOM // (n * steps * len(self.start)))
        for first in range(0, ticks, at_once):
            part = control[:, first : first + at_once]
            state, _ = self._rollout.rollout(
                self.scene.model, self._data, now, np.repeat(part, steps, axis=1)
            )
            found[:, first : first + at_once] = state[:, steps - 1 :: steps]
            now = np.ascontiguousarray(state[:, -1])
        bad = ~np.isfinite(found).all(axis=2)
        found[np.maximum.accumulate(bad, axis=1)] = np.nan
        return self._joints.trajectories(found, period * np.arange(1, ticks + 1), now)

    def close(self) -> None:
        """End the threads."""
        self._rollout.close()


class _Joints(MujocoBase):
    """Where a robot's joints are in MuJoCo's states and controls."""

    def __init__(self, robot: Robot, scene: MujocoScene) -> None:
        super().__init__(robot, scene)
        if scene.model.nmocap or scene.model.nplugin:
            raise DiagnosticError("simulation-scene", "a scene with plugins has no rollouts")
        self.base = self._base

    def control(self, home: Array, speeds: Array, angles: Array) -> Array:
        control = np.repeat(np.repeat(home[None, None], speeds.shape[1], 1), len(speeds), 0)
        for i, motor in self._drive_motors:
            control[:, :, motor] = speeds[:, :, i]
        for i, motor in self._steering_motors:
            control[:, :, motor] = angles[:, :, i]
        return control

    def trajectories(self, states: Array, time: Array, last: Array) -> Trajectories:
        # A state is the time, qpos, qvel and the rest.
        base = 1 + self._base
        moving = 1 + self.scene.model.nq + self._base_velocity
        x, y, _, w, i, j, k = np.moveaxis(states[:, :, base : base + 7], 2, 0)
        yaw = np.unwrap(np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k)), axis=1)
        vx, vy = states[:, :, moving], states[:, :, moving + 1]
        c, s = np.cos(yaw), np.sin(yaw)
        twists = np.stack([c * vx + s * vy, c * vy - s * vx, states[:, :, moving + 5]], axis=2)
        shape = (*states.shape[:2], self._n)
        speeds, angles = np.zeros(shape), np.zeros(shape)
        for wheel, _, v in self._spin:
            speeds[:, :, wheel] = states[:, :, moving + v]
        for wheel, q, _ in self._steering:
            angles[:, :, wheel] = states[:, :, base + q]
        upright = 1.0 - 2.0 * (i * i + j * j)
        poses = np.stack([x, y, yaw], axis=2)
        return Trajectories(time, poses, twists, upright, speeds, angles, last)
