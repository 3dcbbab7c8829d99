"""Loads the MJCF files that the compiler generates, and runs the simulation in MuJoCo.

The MJCF files contain the settings of contacts and servos (``backends/mjcf.py``,
``docs/mjcf.md``).
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
    """Discards a warning message of MuJoCo."""


class MujocoScene:
    """A MuJoCo scene with one or more robots, and the simulated time of the scene.

    ``model`` is the ``MjModel`` of MuJoCo, and ``data`` is the ``MjData``.  ``diverged`` is true
    after a step in which a joint speed is not finite, or the norm of all joint speeds is larger
    than ``_DIVERGED_SPEED``.
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

        If ``visuals`` is false, MuJoCo discards the visual geoms and fuses bodies that are fixed to
        each other.  The simulated physics is the same without visual geoms, and the simulation
        takes three quarters of the time.  However, a scene without visual geoms cannot be rendered,
        and a fused link has no body in the scene.  The function ``prepare`` may change the
        ``MjSpec`` of the scene before MuJoCo compiles the ``MjSpec``.

        Raises ``DiagnosticError`` (``simulation-scene``) if the file is missing or MuJoCo cannot
        read the file.
        """
        if isinstance(files, Mapping):
            self.model = _load_from_memory(files, scene, visuals, prepare)
        else:
            self.model = _load(Path(files), scene, visuals, prepare)
        import mujoco

        self._mujoco = mujoco
        self.data = mujoco.MjData(self.model)
        self.timestep = float(self.model.opt.timestep)
        # By default, MuJoCo resets a diverged simulation to the start without an error.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if self.model.ntree <= 1:
            # A scene with one robot has one island.  The search for islands would take 7 % of the
            # time and give the same motion.
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        self.reset()

    def reset(self) -> None:
        """Resets the scene to the key frame ``home`` and the simulated time to 0."""
        key = self._mujoco.mj_name2id(self.model, self._mujoco.mjtObj.mjOBJ_KEY, HOME)
        if key >= 0:
            self._mujoco.mj_resetDataKeyframe(self.model, self.data, key)
        else:
            self._mujoco.mj_resetData(self.model, self.data)
        self.steps = 0
        self.diverged = False
        self._mujoco.mj_forward(self.model, self.data)

    def forward(self) -> None:
        """Computes the poses and contacts of the scene again after a change of ``data.qpos``."""
        self._mujoco.mj_forward(self.model, self.data)

    @property
    def time(self) -> float:
        """Simulated time (s) since the last reset."""
        return self.steps * self.timestep

    def advance(self, now: float) -> None:
        """Runs the simulation until the time ``now`` (s).

        The time ``now`` is rounded to a whole number of simulation steps.  All simulation steps run
        in one call of MuJoCo.  A call with a time in the past has no effect.
        """
        steps = round(now / self.timestep) - self.steps
        if steps > 0 and not self.diverged:
            # MuJoCo prints warnings about a divergence and writes a log file.  The attribute
            # `diverged` replaces the warnings of MuJoCo.
            mujoco = self._mujoco
            user_warning = mujoco.get_mju_user_warning()
            mujoco.set_mju_user_warning(_ignore)
            try:
                mujoco.mj_step(self.model, self.data, steps)
            finally:
                mujoco.set_mju_user_warning(user_warning)
            self.steps += steps
            speeds = self.data.qvel
            # A joint speed that becomes nan stays nan, so that a test after the last simulation
            # step is enough.  A comparison with nan is false, so that `not <` also detects nan.
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
        """Returns the MuJoCo index of an object of the scene.

        ``kind`` is the type of the object, such as ``joint``, ``actuator`` or ``body``.  Raises
        ``DiagnosticError`` (``simulation-scene``) if the scene does not contain the object.
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
        return _compiled(mujoco.MjSpec.from_file(str(path)), visuals, prepare)
    except ValueError as error:
        text = str(error).replace(f"{folder}/", "")
        raise _unreadable(scene, text) from error


def _load_from_memory(
    files: Mapping[str, bytes], scene: str, visuals: bool, prepare: Prepare
) -> Any:
    import mujoco

    needed = {
        PurePosixPath(name): data
        for name, data in files.items()
        if not {"mjcf", "meshes"}.isdisjoint(PurePosixPath(name).parts)
    }
    others = _by_last_part({path: data for path, data in needed.items() if str(path) != scene})
    if others is not None and scene in files:
        includes = {name: data for name, data in others.items() if name.endswith(".xml")}
        assets = {name: data for name, data in others.items() if name not in includes}
        try:
            spec = mujoco.MjSpec.from_string(files[scene].decode(), includes, assets)
            return _compiled(spec, visuals, prepare)
        except ValueError as error:
            raise _unreadable(scene, str(error)) from error
    with tempfile.TemporaryDirectory(prefix="thorvaldc_") as folder:
        for relative, data in needed.items():
            path = Path(folder, relative)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return _load(Path(folder), scene, visuals, prepare)


def _by_last_part(files: Mapping[PurePosixPath, bytes]) -> dict[str, bytes] | None:
    """Returns the files by the last part of their path, or ``None`` if two files have the same.

    MuJoCo identifies files in memory only by the last part of the path, and the robots of a fleet
    have files with equal last parts.  MuJoCo identifies files on disk by the whole path.
    """
    by_name = {path.name: data for path, data in files.items()}
    if any(by_name[path.name] != data for path, data in files.items()):
        return None
    return by_name


def _compiled(spec: Any, visuals: bool, prepare: Prepare) -> Any:
    spec.compiler.discardvisual = not visuals
    spec.compiler.fusestatic = not visuals
    if prepare is not None:
        prepare(spec)
    return spec.compile()


def _unreadable(scene: str, message: str) -> DiagnosticError:
    text = message.strip().replace("\n", "; ")
    return DiagnosticError("simulation-scene", f"MuJoCo cannot read {scene}: {text}")
