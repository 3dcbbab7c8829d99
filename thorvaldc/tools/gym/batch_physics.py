"""Many copies of one MuJoCo scene that advance together: ``mujoco.batch``, or MuJoCo Warp.

A *world* is one copy.  For the base, the driver and the environment of a robot, it is a
``MujocoScene``: they read and write the same arrays, which are here rows of the arrays of all
worlds.  One control cycle of all environments::

    advance     one call of MuJoCo: all worlds, up to the tick of the driver
    tick        for each world: the driver reads its row, and writes its commands into the row

- ``MujocoPhysics`` needs MuJoCo 3.17.  A world moves as its ``MujocoScene`` would, to the last bit.
- ``WarpPhysics`` needs MuJoCo Warp.  It computes in single precision, on a GPU or on the CPU.  The
  rows are copied from and to the device in every control cycle.
"""

from __future__ import annotations

import abc
import copy
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from thorvaldc.diagnostics.installation import install_command
from thorvaldc.simulation.physics.mujoco_scene import HOME, MujocoScene, call_without_warnings

DEVICE_STATE = ("qpos", "qvel", "act", "ctrl", "qfrc_applied")
"""Arrays of MuJoCo that a base or the limits of its servos may write."""


class World(MujocoScene):
    """One world of a batch, as the scene of one environment."""

    def __init__(self, physics: BatchPhysics, number: int) -> None:
        import mujoco

        self._mujoco = mujoco
        self._physics, self._number = physics, number
        self.model, self.data = physics.models[number], physics.row(number)
        self.timestep = float(self.model.opt.timestep)
        self.sensors = None
        self.reset()

    def reset(self) -> None:
        self._physics.reset(self._number)
        self.steps = 0
        self.diverged = False

    def forward(self) -> None:
        self._physics.forward(self._number)

    def step_to(self, now: float) -> None:
        """Does nothing: ``advance_all`` has run the world until ``now`` (s) before."""
        if not self.diverged and round(now / self.timestep) > self.steps:
            raise RuntimeError("a world of a batch advances only in `advance_all`")

    @property
    def number(self) -> int:
        return self._number


def advance_all(physics: BatchPhysics, times: Mapping[World, float]) -> None:
    """Runs each world of a batch until its time (s), all in as few calls as possible."""
    steps = {
        world: round(now / world.timestep) - world.steps
        for world, now in times.items()
        if not world.diverged
    }
    due = {world: number for world, number in steps.items() if number > 0}
    for number in sorted(set(due.values())):
        worlds = [world for world, own in due.items() if own == number]
        physics.step([world.number for world in worlds], number)
        for world in worlds:
            world.note_steps(number)


class BatchPhysics(abc.ABC):
    """The physics of all worlds.

    ``models`` has the ``MjModel`` of each world, which may be one object.
    """

    models: list[Any]

    @abc.abstractmethod
    def row(self, number: int) -> Any:
        """Returns the arrays of a world with the names of ``MjData``, which keep their memory."""

    @abc.abstractmethod
    def reset(self, number: int) -> None:
        """Puts a world into the key frame ``home``, and computes its contacts."""

    @abc.abstractmethod
    def forward(self, number: int) -> None:
        """Computes the contacts of a world after a change of its ``qpos``."""

    @abc.abstractmethod
    def step(self, numbers: list[int], steps: int) -> None:
        """Runs simulation steps of the worlds with these numbers, in rising order."""


class _Row(SimpleNamespace):
    """The arrays of one world, by the names of ``MjData``; ``contacts`` computes ``contact``."""

    @property
    def contact(self) -> Any:
        return self.contacts()


class MujocoPhysics(BatchPhysics):
    """``mujoco.batch`` on the threads of the CPU.

    - ``start``: the scene of one world.
    - ``own_models``: whether faults and zones of a scenario change the model of each world.
    - ``threads``: number of threads, or 0 for one on each processor.

    Raises ``ImportError`` if MuJoCo is older than 3.17.
    """

    def __init__(self, start: MujocoScene, count: int, own_models: bool, threads: int) -> None:
        import mujoco

        try:
            from mujoco.batch import Batch
        except ImportError:
            raise ImportError(
                f"the batch needs MuJoCo 3.17 or newer, and MuJoCo {mujoco.__version__} is"
                f" installed: {install_command('batch')}; environments without a batch work with"
                " it, with vectorization_mode `sync` or `async`"
            ) from None
        # Only a persistent batch keeps the contacts.
        self._batch = Batch(start.model, count, threads, persistent=True)
        self._own_models = own_models
        self.models = [start.model] * count
        if own_models:
            self.models = [copy.copy(start.model) for _ in range(count)]
            self._batch.set_models(self.models)
        self._key = mujoco.mj_name2id(start.model, mujoco.mjtObj.mjOBJ_KEY, HOME)
        self._copy = mujoco.MjData(start.model)

    def row(self, number: int) -> Any:
        arrays = {
            name: self._batch.bind(name)[number, ...] for name in (*DEVICE_STATE, "time", "xpos")
        }
        return _Row(**arrays, contacts=lambda: self._contact(number))

    def reset(self, number: int) -> None:
        self._use_models()
        self._batch.reset([number], self._key)

    def forward(self, number: int) -> None:
        self._use_models()
        self._batch.forward([number])

    def step(self, numbers: list[int], steps: int) -> None:
        self._use_models()
        call_without_warnings(self._batch.step, numbers, steps)

    def _contact(self, number: int) -> Any:
        return self._batch.get_data(number, self._copy).contact

    def _use_models(self) -> None:
        """Makes the batch read the models again, which faults may have changed."""
        if self._own_models:
            self._batch.set_models(self.models)


class WarpPhysics(BatchPhysics):
    """MuJoCo Warp on a device such as ``cuda:0`` or ``cpu``; by default the one that Warp prefers.

    All worlds step in every call of ``step``, also those that wait for a reset.  The start of an
    episode is computed by MuJoCo in ``start``.

    Raises ``ImportError`` if MuJoCo Warp is not installed.
    """

    def __init__(self, start: MujocoScene, count: int, device: str | None) -> None:
        import mujoco

        try:
            import warp

            # Warp prints a line for each kernel that it loads, from the import on.
            warp.config.log_level = warp.LOG_WARNING
            import mujoco_warp
        except ImportError:
            raise ImportError(f"MuJoCo Warp is not installed: {install_command('warp')}") from None
        self._warp, self._mujoco_warp = warp, mujoco_warp
        self._device, self._start = device, start
        self.models = [start.model] * count
        # Warp never resets a diverged world, and refuses the flag that forbids it.
        model = copy.copy(start.model)
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        with warp.ScopedDevice(device):
            try:
                self._model = mujoco_warp.put_model(model)
            except NotImplementedError as error:
                raise ValueError(f"MuJoCo Warp cannot simulate the scene: {error}") from error
            self._data = mujoco_warp.put_data(start.model, start.data, nworld=count)
        self._arrays = {
            name: np.repeat(getattr(start.data, name)[None], count, axis=0) for name in DEVICE_STATE
        }
        self._times = np.zeros(count)
        self._resets = np.zeros(count, dtype=bool)
        self._geoms = [np.zeros((0, 2), dtype=np.int32)] * count

    def row(self, number: int) -> Any:
        arrays = {name: array[number] for name, array in self._arrays.items()}
        return _Row(
            **arrays,
            time=self._times[number, ...],
            contacts=lambda: SimpleNamespace(geom=self._geoms[number]),
        )

    def reset(self, number: int) -> None:
        self._start.reset()
        self._resets[number] = True
        self._times[number] = 0.0
        for name, array in self._arrays.items():
            array[number] = getattr(self._start.data, name)
        self._geoms[number] = self._start.data.contact.geom.copy()

    def forward(self, number: int) -> None:
        self._start.reset()
        self._start.data.qpos[:] = self._arrays["qpos"][number]
        self._start.forward()
        self._geoms[number] = self._start.data.contact.geom.copy()

    def step(self, numbers: list[int], steps: int) -> None:
        engine, model, data = self._mujoco_warp, self._model, self._data
        with self._warp.ScopedDevice(self._device):
            if self._resets.any():
                engine.reset_data(model, data, self._warp.array(self._resets, dtype=bool))
                self._resets[:] = False
            for name, array in self._arrays.items():
                getattr(data, name).assign(array.astype(np.float32))
            for _ in range(steps):
                engine.step(model, data)
            for name in ("qpos", "qvel", "act"):
                self._arrays[name][:] = getattr(data, name).numpy()
            contacts = min(int(data.nacon.numpy()[0]), data.naconmax)
            worlds = data.contact.worldid.numpy()[:contacts]
            geoms = data.contact.geom.numpy()[:contacts]
        self._times += steps * float(self._start.model.opt.timestep)
        order = np.argsort(worlds, kind="stable")
        ends = np.cumsum(np.bincount(worlds, minlength=len(self._geoms)))
        self._geoms = np.split(geoms[order], ends[:-1])
