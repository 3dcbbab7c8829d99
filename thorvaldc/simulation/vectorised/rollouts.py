"""Simulates many open-loop runs of one robot in parallel threads, for planning and identification.

The function ``mujoco.rollout`` computes the true motion for given joint commands.  The simulated
runs use no base driver and no odometry.  To simulate the base driver, injected faults or noise, use
a batch of scenarios.
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
from thorvaldc.simulation.physics.drive_servos import ServoMemory
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trajectories:
    """Results of n simulated runs, sampled at the ends of t ticks.

    If a simulated run diverges, all later samples of the run are NaN.

    - ``time``: times of the samples, shape (t,), s.
    - ``poses``: pose of ``base_link`` in the scene, shape (n, t, 3): x, y (m) and yaw (rad, not
      wrapped).
    - ``twists``: twist of ``base_link``, shape (n, t, 3): vx, vy (m/s) and wz (rad/s).
    - ``uprightness``: cosine of the tilt angle, shape (n, t).
    - ``speeds``: wheel speeds, shape (n, t, wheels), rad/s.
    - ``angles``: steering angles, shape (n, t, wheels), rad.
    - ``states``: final MuJoCo states of the runs, shape (n, state).  Later runs can start from the
      final MuJoCo states.
    """

    time: Array
    poses: Array
    twists: Array
    uprightness: Array
    speeds: Array
    angles: Array
    states: Array


class Rollouts:
    """A robot alone in a MuJoCo scene, prepared for many simulated runs."""

    def __init__(
        self, robot: Robot, files: Path | str | Mapping[str, bytes], threads: int = 1
    ) -> None:
        """Loads the robot into a MuJoCo scene.

        ``files`` has the same meaning as for ``MujocoScene``.  Raises ``DiagnosticError`` if the
        scene cannot be loaded, and ``ValueError`` if ``threads`` is less than 1.
        """
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
        """MuJoCo state of the robot at rest in its initial pose."""
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._rollout = Rollout(nthread=threads)
        self._home = self.scene.data.ctrl.copy()

    def at(self, poses: ArrayLike) -> Array:
        """Returns the MuJoCo states (n, state) of the robot at rest at given poses.

        ``poses`` has the shape (n, 3): x, y (m) and yaw (rad).
        """
        targets = np.atleast_2d(np.asarray(poses, dtype=np.float64))
        states = np.repeat(self.start[None], len(targets), axis=0)
        first = 1 + self._joints.base
        w, i, j, k = self.start[first + 3 : first + 7]
        half = targets[:, 2] / 2.0
        c, s = np.cos(half), np.sin(half)
        states[:, first : first + 2] = targets[:, :2]
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
        """Simulates n runs of the robot with given joint commands.

        - ``speeds``: wheel speeds of the commands, shape (n, t, wheels), rad/s.  Commands for
          wheels without drive motor are not used.
        - ``angles``: steering angles of the commands, shape (n, t, wheels), rad.  Commands for
          wheels without steering motor are not used.  By default all steering angles are 0.
        - ``period``: duration of each joint command in s, a multiple of the scene's time step.
        - ``states``: MuJoCo states at the start of the runs, shape (n, state).  By default all runs
          start from the state ``start``.

        The simulated trajectories do not depend on the number of threads.  Raises ``ValueError`` if
        an array has the wrong shape or the period is not a multiple of the time step.
        """
        speed_commands = np.asarray(speeds, dtype=np.float64)
        if angles is None:
            angle_commands = np.zeros_like(speed_commands)
        else:
            angle_commands = np.asarray(angles, dtype=np.float64)
        steps = round(period / self.scene.timestep)
        if speed_commands.ndim != 3 or speed_commands.shape[2] != len(self.robot.wheels):
            raise ValueError(
                f"speeds are (n, t, {len(self.robot.wheels)}), not {speed_commands.shape}"
            )
        if angle_commands.shape != speed_commands.shape:
            raise ValueError(
                f"angles are {angle_commands.shape}, and speeds {speed_commands.shape}"
            )
        if steps < 1 or not math.isclose(steps * self.scene.timestep, period, rel_tol=1e-6):
            raise ValueError(
                f"a period of {period:g} s is no whole number of {self.scene.timestep:g} s"
            )
        n, ticks, _ = speed_commands.shape
        control = self._joints.control(self._home, speed_commands, angle_commands)
        current = np.repeat(self.start[None], n, axis=0) if states is None else np.array(states)
        if current.shape != (n, len(self.start)):
            raise ValueError(f"states are {current.shape}; they must be {(n, len(self.start))}")
        samples = np.empty((n, ticks, len(self.start)))
        memories = [self._joints.servos.memory(float(state[0])) for state in current]
        # One call of MuJoCo per command, because MuJoCo itself cannot limit the set points of the
        # drive servos.
        for tick in range(ticks):
            state, _ = self._rollout.rollout(
                self.scene.model,
                self._data,
                current,
                np.repeat(control[:, tick : tick + 1], steps, axis=1),
            )
            current = np.ascontiguousarray(state[:, -1])
            samples[:, tick] = current
            for run, memory in enumerate(memories):
                self._joints.limit(memory, current[run], control[run, tick])
        diverged = ~np.isfinite(samples).all(axis=2)
        samples[np.maximum.accumulate(diverged, axis=1)] = np.nan
        return self._joints.trajectories(samples, period * np.arange(1, ticks + 1), current)

    def close(self) -> None:
        """Ends the threads that simulate the runs."""
        self._rollout.close()


class _Joints(MujocoBase):
    """Indices of a robot's joints in the states and controls of MuJoCo."""

    def __init__(self, robot: Robot, scene: MujocoScene) -> None:
        super().__init__(robot, scene)
        if scene.model.nmocap or scene.model.nplugin:
            raise DiagnosticError("simulation-scene", "a scene with plugins has no rollouts")
        self.base = self._base

    def limit(self, memory: ServoMemory, state: Array, control: Array) -> None:
        """Limits the set points of the drive servos in one MuJoCo state."""
        nq, nv = self.scene.model.nq, self.scene.model.nv
        # A MuJoCo state contains the time, positions (qpos), velocities (qvel) and activations.
        values = state.tolist()
        act = values[1 + nq + nv :]
        positions, speeds = values[1 : 1 + nq], values[1 + nq : 1 + nq + nv]
        if self.servos.limit_activations(
            memory, values[0], control.tolist(), act, positions, speeds
        ):
            state[1 + nq + nv :] = act

    def control(self, home: Array, speeds: Array, angles: Array) -> Array:
        control = np.repeat(np.repeat(home[None, None], speeds.shape[1], 1), len(speeds), 0)
        for i, motor in self._drive_motors:
            control[:, :, motor] = speeds[:, :, i]
        for i, motor in self._steering_motors:
            control[:, :, motor] = angles[:, :, i]
        return control

    def trajectories(self, states: Array, time: Array, last: Array) -> Trajectories:
        # A MuJoCo state contains the time, positions (qpos), velocities (qvel) and activations.
        base = 1 + self._base
        moving = 1 + self.scene.model.nq + self._base_velocity
        x, y, _, w, i, j, k = np.moveaxis(states[:, :, base : base + 7], 2, 0)
        yaw = np.unwrap(np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k)), axis=1)
        vx, vy = states[:, :, moving], states[:, :, moving + 1]
        c, s = np.cos(yaw), np.sin(yaw)
        twists = np.stack([c * vx + s * vy, c * vy - s * vx, states[:, :, moving + 5]], axis=2)
        shape = (*states.shape[:2], self._n)
        speeds, angles = np.zeros(shape), np.zeros(shape)
        for wheel, _, v in self.spin_joints:
            speeds[:, :, wheel] = states[:, :, moving + v]
        for wheel, q, _ in self.steering_joints:
            angles[:, :, wheel] = states[:, :, base + q]
        upright = 1.0 - 2.0 * (i * i + j * j)
        poses = np.stack([x, y, yaw], axis=2)
        return Trajectories(time, poses, twists, upright, speeds, angles, last)
