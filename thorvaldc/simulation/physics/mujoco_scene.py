"""MuJoCo scenes: loads the MJCF files that the compiler generates, and steps the simulation.

The MJCF has the contact and servo settings (``backends/mjcf.py``, ``docs/mjcf.md``).
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Robot

SCENE = "mjcf/scene.xml"
HOME = "home"
Prepare = Callable[[Any], None] | None
_DIVERGED_SPEED = 1e4
"""Norm of all joint speeds (m/s, rad/s) from which a simulation counts as diverged."""


def _ignore(message: str) -> None:
    """Discards a warning of MuJoCo."""


class MujocoScene:
    """A compiled scene with one or more robots, and its simulated time.

    ``model`` and ``data`` are the objects of MuJoCo.  ``diverged`` is true after a step with
    speeds that are not finite or absurdly large.
    """

    def __init__(
        self,
        files: Path | str | Mapping[str, bytes],
        scene: str = SCENE,
        *,
        visuals: bool = False,
        prepare: Prepare = None,
    ) -> None:
        """Loads the file ``scene`` from a build folder or from ``{path: bytes}``.

        Without ``visuals`` MuJoCo discards visual geoms and fuses bodies that are fixed to
        each other: the same physics in three quarters of the time, but there is nothing to
        render, and fused links have no body.  ``prepare`` may change the ``MjSpec`` before it
        is compiled.

        Raises ``DiagnosticError`` (``simulation-scene``) if the file is missing or MuJoCo
        cannot read it.
        """
        if isinstance(files, Mapping):
            self.model = _load_from_memory(files, scene, visuals, prepare)
        else:
            self.model = _load(Path(files), scene, visuals, prepare)
        import mujoco

        self._mujoco = mujoco
        self.data = mujoco.MjData(self.model)
        self.timestep = float(self.model.opt.timestep)
        # MuJoCo would reset a diverged simulation to its start without an error.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.reset()

    def reset(self) -> None:
        """Resets the scene to the key frame ``home``, at time 0."""
        key = self._mujoco.mj_name2id(self.model, self._mujoco.mjtObj.mjOBJ_KEY, HOME)
        if key >= 0:
            self._mujoco.mj_resetDataKeyframe(self.model, self.data, key)
        else:
            self._mujoco.mj_resetData(self.model, self.data)
        self.steps = 0
        self.diverged = False
        self._mujoco.mj_forward(self.model, self.data)

    def forward(self) -> None:
        """Updates poses, contacts and other derived values after a change of ``data.qpos``."""
        self._mujoco.mj_forward(self.model, self.data)

    @property
    def time(self) -> float:
        """Simulated time in s since the reset."""
        return self.steps * self.timestep

    def advance(self, now: float) -> None:
        """Runs the steps up to ``now`` (s, rounded) in one call; a past time has no effect."""
        steps = round(now / self.timestep) - self.steps
        if steps > 0 and not self.diverged:
            # MuJoCo prints warnings and writes a log file; `diverged` replaces them.
            mujoco = self._mujoco
            user_warning = mujoco.get_mju_user_warning()
            mujoco.set_mju_user_warning(_ignore)
            try:
                mujoco.mj_step(self.model, self.data, steps)
            finally:
                mujoco.set_mju_user_warning(user_warning)
            self.steps += steps
            speeds = self.data.qvel
            # A speed that is nan stays nan, so the last step of the call is enough;
            # a comparison with nan is false, so `not <` detects it.
            self.diverged = not speeds.dot(speeds) < _DIVERGED_SPEED**2

    @property
    def fastest(self) -> str:
        """Description of the fastest joint, or of a joint whose speed is not finite."""
        import numpy

        speeds = numpy.abs(self.data.qvel)
        if not len(speeds):
            return "no joint moves"
        not_finite = numpy.flatnonzero(~numpy.isfinite(speeds))
        dof = int(not_finite[0]) if len(not_finite) else int(speeds.argmax())
        joint = int(self.model.dof_jntid[dof])
        name = self._mujoco.mj_id2name(self.model, self._mujoco.mjtObj.mjOBJ_JOINT, joint)
        speed = float(speeds[dof])
        if not math.isfinite(speed):
            return f"the speed of the joint `{name}` is not finite"
        return f"the joint `{name}` moves at {speed:.3g} (SI)"

    def index(self, kind: str, name: str, robot: Robot) -> int:
        """Returns MuJoCo's index of an object; ``kind`` is ``joint``, ``actuator``, ``body``, ...

        Raises ``DiagnosticError`` (``simulation-scene``) if the scene does not have it.
        """
        objects = self._mujoco.mjtObj
        index: int = self._mujoco.mj_name2id(
            self.model, getattr(objects, f"mjOBJ_{kind.upper()}"), name
        )
        if index < 0:
            raise DiagnosticError(
                "simulation-scene",
                f"the scene has no {kind} `{name}` of {robot.name}",
                robot.span,
                hint="model.json and the MJCF files come from different builds: build again",
            )
        return index


def _load(folder: Path, scene: str, visuals: bool, prepare: Prepare) -> Any:
    import mujoco

    path = folder / scene
    if not path.is_file():
        raise DiagnosticError(
            "simulation-scene",
            f"{folder} has no file {scene}",
            hint="build the robot with --target mjcf first",
        )
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = not visuals
        spec.compiler.fusestatic = not visuals
        if prepare is not None:
            prepare(spec)
        return spec.compile()
    except ValueError as error:
        text = str(error).replace(f"{folder}/", "").strip().replace("\n", "; ")
        raise DiagnosticError("simulation-scene", f"MuJoCo cannot read {scene}: {text}") from error


def _load_from_memory(
    files: Mapping[str, bytes], scene: str, visuals: bool, prepare: Prepare
) -> Any:
    # MuJoCo identifies virtual files by their base names alone, and the robots of a fleet have
    # files of equal base names.  So the files go to a temporary folder.
    with tempfile.TemporaryDirectory(prefix="thorvaldc_") as folder:
        for name, data in files.items():
            parts = PurePosixPath(name).parts
            if "mjcf" not in parts and "meshes" not in parts:
                continue
            path = Path(folder, *parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return _load(Path(folder), scene, visuals, prepare)
