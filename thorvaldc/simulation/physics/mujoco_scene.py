"""Loads the MJCF files that the compiler generates, and runs the simulation in MuJoCo.

The MJCF files contain the settings of contacts and servos (``backends/mjcf.py``,
``docs/mjcf.md``).
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.statics.ground_contacts import standing_links
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.runtime.mypyc_marks import mypyc_attr
from thorvaldc.simulation.physics import fleet_reader

SCENE: Final = "mjcf/scene.xml"
HOME: Final = "home"
SceneFiles = Path | str | Mapping[str, bytes]
Prepare = Callable[[Any], None] | None
_DIVERGED_SPEED: Final = 1e4
"""Norm of all joint speeds (m/s, rad/s) from which a simulation counts as diverged."""


def _ignore(message: str) -> None:
    """Discards a warning message of MuJoCo."""


def call_without_warnings(function: Callable[..., Any], *arguments: Any) -> Any:
    """Calls a function of MuJoCo; its warnings are neither printed nor logged.

    MuJoCo prints warnings about a divergence and writes a log file.  ``MujocoScene.diverged``
    replaces them.
    """
    import mujoco

    user_warning = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(_ignore)
    try:
        return function(*arguments)
    finally:
        mujoco.set_mju_user_warning(user_warning)


@mypyc_attr(allow_interpreted_subclasses=True)
class MujocoScene:
    """A MuJoCo scene with one or more robots, and the simulated time of the scene.

    ``model`` is the ``MjModel`` of MuJoCo, and ``data`` is the ``MjData``.  ``diverged`` is true
    after a step in which a joint speed is not finite, or the norm of all joint speeds is larger
    than ``_DIVERGED_SPEED``.  ``sensors`` is a ``SensorSuite`` that measures during the steps, or
    ``None``.
    """

    def __init__(
        self,
        files: SceneFiles,
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
        model = None if visuals or prepare is not None else _load_fleet(files, scene)
        if model is None:
            if isinstance(files, Mapping):
                model = _load_from_memory(files, scene, visuals, prepare)
            else:
                model = _load(Path(files), scene, visuals, prepare)
        import mujoco

        self._mujoco = mujoco
        self.model = model
        self.data = mujoco.MjData(model)
        self.timestep = float(self.model.opt.timestep)
        self.sensors: Any = None
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
        if self.sensors is not None:
            self.sensors.reset()

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
        in one call of MuJoCo.  A call with a time in the past has no effect.  Sensors measure at
        their own times, between two calls of MuJoCo.
        """
        if self.sensors is not None:
            self.sensors.advance(now)
        self.step_to(now)

    def step_to(self, now: float) -> None:
        """Runs the simulation as ``advance``, without measurements of the sensors."""
        steps = round(now / self.timestep) - self.steps
        if steps > 0 and not self.diverged:
            call_without_warnings(self._mujoco.mj_step, self.model, self.data, steps)
            self.note_steps(steps)

    def note_steps(self, steps: int) -> None:
        """Counts simulation steps that were run, and notes whether the simulation diverged."""
        self.steps += steps
        squares = 0.0
        speeds: list[float] = self.data.qvel.tolist()
        for speed in speeds:
            squares += speed * speed
        # A joint speed that becomes nan stays nan, so that a test after the last simulation step is
        # enough.  A comparison with nan is false, so that `not <` also detects nan.
        self.diverged = not squares < _DIVERGED_SPEED**2

    @property
    def fastest(self) -> str:
        """Description of the fastest joint, or of a joint whose speed is not finite."""
        speeds = [abs(float(speed)) for speed in self.data.qvel]
        if not speeds:
            return "no joint moves"
        not_finite = [dof for dof, speed in enumerate(speeds) if not math.isfinite(speed)]
        dof = not_finite[0] if not_finite else speeds.index(max(speeds))
        joint = int(self.model.dof_jntid[dof])
        name = self._mujoco.mj_id2name(self.model, self._mujoco.mjtObj.mjOBJ_JOINT, joint)
        if not_finite:
            return f"the speed of the joint `{name}` is not finite"
        return f"the joint `{name}` moves at {speeds[dof]:.3g} (SI)"

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


def _load_fleet(files: SceneFiles, scene: str) -> Any:
    """Returns the model of a large fleet, or ``None`` if ``_load`` has to read the scene."""
    try:
        text = files[scene] if isinstance(files, Mapping) else Path(files, scene).read_bytes()
        return call_without_warnings(fleet_reader.read_fleet, text)
    except (KeyError, OSError, SyntaxError, ValueError):
        return None  # `_load` says what is wrong, with the name of the file


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


# -- collisions ------------------------------------------------------------------------------------

DRIVABLE: Final = ("ground", "rail", "kerb")
"""First parts of the names of the geoms on which wheels may roll."""


class CollisionCounter:
    """Counts the collisions of each robot.

    ``collisions`` maps each robot name to the number of collisions.  A wheel may touch the ground,
    rails and kerbs, and so may other parts that stand on the ground, such as the wheels of a
    trailer.  Every other contact of a robot counts as a collision.  For example, a contact
    of the chassis with the ground is a collision.  A contact that lasts for several simulation
    steps counts as one collision.
    """

    def __init__(self, scene: MujocoScene, robots: Mapping[str, Robot]) -> None:
        import mujoco  # late: the user of the module chooses the OpenGL backend before

        self._scene = scene
        model = scene.model
        self.collisions = dict.fromkeys(robots, 0)
        owners: dict[int, str] = {}
        wheel_bodies: set[int] = set()
        standing_geoms: tuple[str, ...] = ()
        for name, robot in robots.items():
            prefix = robot.prefix
            owners[scene.index("body", prefix + robot.links[0].name, robot)] = name
            # The body of a wheel is found by the spin joint, because MuJoCo may have fused the
            # wheel link into another body.
            joints = (scene.index("joint", prefix + w.spin_joint, robot) for w in robot.wheels)
            wheel_bodies |= {int(model.jnt_bodyid[joint]) for joint in joints}
            links = standing_links(tree_of(robot), robot.wheels, robot.meshes)
            standing_geoms += tuple(f"{prefix}{link}_collision_" for link in links)
        # Lists with one item for each geom of the MuJoCo scene.  ``_owner`` is the name of the
        # robot with the geom, or an empty text for a geom of the world.
        self._owner: list[str] = []
        self._may_roll: list[bool] = []
        self._is_drivable: list[bool] = []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or ""
            self._owner.append(owners.get(int(model.body_rootid[body]), ""))
            self._may_roll.append(body in wheel_bodies or name.startswith(standing_geoms))
            self._is_drivable.append(body == 0 and name.split("/")[0] in DRIVABLE)
        self._pairs: list[list[int]] = []
        self._contacts: frozenset[tuple[int, int]] = frozenset()
        self._step = -1

    def update(self) -> None:
        """Counts the collisions that began since the last call of ``update``."""
        if self._scene.steps == self._step:
            return
        self._step = self._scene.steps
        pairs = self._scene.data.contact.geom.tolist()
        if pairs == self._pairs:
            return
        self._pairs = pairs
        contacts = frozenset(
            (a, b)
            for a, b in pairs
            if not (
                (self._may_roll[a] and self._is_drivable[b])
                or (self._may_roll[b] and self._is_drivable[a])
            )
        )
        for a, b in contacts - self._contacts:
            for name in {self._owner[a], self._owner[b]}:
                if name:
                    self.collisions[name] += 1
        self._contacts = contacts


# -- treads of wheels ------------------------------------------------------------------------------

# A wheel with several treads rolls on the tyre on the ground, and on a ring on a rail.


class RollingRadii:
    """Finds the tread on which each wheel of a robot rolls.

    The contacts in the MuJoCo scene determine the tread on which a wheel rolls.
    """

    def __init__(self, robot: Robot, scene: MujocoScene) -> None:
        prefix = robot.prefix
        self._scene = scene
        self._tyres = [wheel.radius for wheel in robot.wheels]
        # (geom, wheel, radius in m) of the treads beside the tyres.
        self._treads = [
            (
                scene.index("geom", f"{prefix}{wheel.link}_{tread.name}", robot),
                i,
                wheel.radius_named(tread.name),
            )
            for i, wheel in enumerate(robot.wheels)
            for tread in wheel.treads
        ]

    def current(self) -> list[float]:
        """Returns the current rolling radius (m) of each wheel.

        The rolling radius of a wheel in the air is the radius of the tyre.
        """
        touching = set(self._scene.data.contact.geom.ravel().tolist())
        radii = list(self._tyres)
        for geom, wheel, radius in self._treads:
            if geom in touching:
                radii[wheel] = radius
        return radii
