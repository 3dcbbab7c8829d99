"""A base in MuJoCo: physics, from the files that the compiler generated."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.physics.ground_truth_base import GroundTruthBase
from thorvaldc.simulation.physics.wheel_errors import WheelErrors

SCENE = "mjcf/scene.xml"
HOME = "home"
Prepare = Callable[[Any], None] | None
LONGEST_STEP = 0.2
"""Time (s) between two commands beyond which they are no longer steps of one motion."""
_OUT_OF_BOUNDS = 1e4
"""Speed (m/s, rad/s) that nothing on a robot has."""


def _ignore(message: str) -> None:
    """A warning of MuJoCo's that is counted elsewhere."""


class MujocoScene:
    """A compiled scene and its time.  Several robots may move in it.

    ``model`` and ``data`` are MuJoCo's own objects; ``diverged`` says whether the last
    advance left the numbers.
    """

    def __init__(
        self,
        files: Path | str | Mapping[str, bytes],
        scene: str = SCENE,
        *,
        visuals: bool = False,
        prepare: Prepare = None,
    ) -> None:
        """Load the scene ``scene`` from a build folder or from ``{path: bytes}``.

        Without ``visuals`` MuJoCo leaves out what is only seen and welds
        together what does not move: the same physics in three quarters of the
        time, with nothing to render and no body for a welded link.  ``prepare``
        may change the ``MjSpec`` before it is compiled.

        Raises ``DiagnosticError`` (``simulation-scene``) where it is missing or
        MuJoCo cannot read it.
        """
        if isinstance(files, Mapping):
            self.model = _load_from_memory(files, scene, visuals, prepare)
        else:
            self.model = _load(Path(files), scene, visuals, prepare)
        import mujoco

        self._mujoco = mujoco
        self.data = mujoco.MjData(self.model)
        self.timestep = float(self.model.opt.timestep)
        # MuJoCo's own reset on divergence would hide it.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.reset()

    def reset(self) -> None:
        """Back to the key frame ``home``, at time 0."""
        key = self._mujoco.mj_name2id(self.model, self._mujoco.mjtObj.mjOBJ_KEY, HOME)
        if key >= 0:
            self._mujoco.mj_resetDataKeyframe(self.model, self.data, key)
        else:
            self._mujoco.mj_resetData(self.model, self.data)
        self.steps = 0
        self.diverged = False
        self._mujoco.mj_forward(self.model, self.data)

    def forward(self) -> None:
        """Work out where everything is, after a change of ``data.qpos``."""
        self._mujoco.mj_forward(self.model, self.data)

    @property
    def time(self) -> float:
        """Simulated time in s since the reset."""
        return self.steps * self.timestep

    def advance(self, now: float) -> None:
        """Step to ``now`` in one call, to the nearest whole step; never back."""
        steps = round(now / self.timestep) - self.steps
        if steps > 0 and not self.diverged:
            # Its warnings would be printed and logged to a file; `diverged` tells of them.
            mujoco = self._mujoco
            before = mujoco.get_mju_user_warning()
            mujoco.set_mju_user_warning(_ignore)
            try:
                mujoco.mj_step(self.model, self.data, steps)
            finally:
                mujoco.set_mju_user_warning(before)
            self.steps += steps
            speeds = self.data.qvel
            # Once no number, a speed stays none, and so is their norm.
            self.diverged = not speeds.dot(speeds) < _OUT_OF_BOUNDS**2

    @property
    def fastest(self) -> str:
        """The joint that moves fastest, or is no number, and how it moves."""
        import numpy

        speeds = numpy.abs(self.data.qvel)
        if not len(speeds):
            return "nothing moves"
        wild = numpy.flatnonzero(~numpy.isfinite(speeds))
        dof = int(wild[0]) if len(wild) else int(speeds.argmax())
        joint = int(self.model.dof_jntid[dof])
        name = self._mujoco.mj_id2name(self.model, self._mujoco.mjtObj.mjOBJ_JOINT, joint)
        speed = float(speeds[dof])
        how = f"moves at {speed:.3g} (SI)" if math.isfinite(speed) else "moves at no finite speed"
        return f"the joint `{name}` {how}"

    def index(self, kind: str, name: str, robot: Robot) -> int:
        """MuJoCo's number of the ``kind`` (``joint``, ``actuator``, ``body``) of that name."""
        objects = self._mujoco.mjtObj
        found: int = self._mujoco.mj_name2id(
            self.model, getattr(objects, f"mjOBJ_{kind.upper()}"), name
        )
        if found < 0:
            raise DiagnosticError(
                "simulation-scene",
                f"the scene has no {kind} `{name}`, which {robot.name} has",
                robot.span,
                hint="model.json and the MJCF files come from different builds: build again",
            )
        return found


class MujocoBase(GroundTruthBase):
    """The joints of one robot of a scene, and what only a simulation knows.

    Joints, actuators and bodies are found by their names, which start with
    ``prefix`` (by default the robot's name space and a slash).

    ``hidden`` errors are made between the joints and what is told of them: a wheel
    that is larger by some ratio rolls as one of the model's radius that turns
    faster by it.  With ``open_loop`` the drives get a voltage in place of a
    speed that they hold: their torque falls in a line from the largest at rest
    to none at the speed asked for, so that wheels give way to one another.
    """

    def __init__(
        self,
        robot: Robot,
        scene: MujocoScene,
        prefix: str | None = None,
        *,
        wheel_errors: WheelErrors | None = None,
        open_loop: bool = False,
    ) -> None:
        """Raises ``DiagnosticError`` where the scene is not of this robot."""
        if prefix is None:
            prefix = robot.prefix
        self.robot = robot
        self.scene = scene
        model = scene.model
        self._n = len(robot.wheels)
        wheel_errors = wheel_errors or WheelErrors.none(robot)
        self._ratios, self._offsets = wheel_errors.radius_ratios, wheel_errors.steering_offsets
        body = scene.index("body", prefix + robot.links[0].name, robot)
        free = int(model.body_jntadr[body])
        if free < 0 or int(model.body_dofnum[body]) != 6:
            raise DiagnosticError(
                "simulation-scene",
                f"the body `{prefix + robot.links[0].name}` of the scene has no free joint",
                robot.span,
            )
        self._base = int(model.jnt_qposadr[free])
        self._base_velocity = int(model.jnt_dofadr[free])
        # (wheel, place in qpos, in qvel) of the joints, (wheel, actuator) of the motors; places
        # count from those of the base, after which a robot's joints lie.
        self._spin: list[tuple[int, int, int]] = []
        self._steering: list[tuple[int, int, int]] = []
        self._drive_motors: list[tuple[int, int]] = []
        self._steering_motors: list[tuple[int, int]] = []
        for i, wheel in enumerate(robot.wheels):
            for name, joints, motors in (
                (wheel.spin_joint, self._spin, self._drive_motors),
                (wheel.steering_joint, self._steering, self._steering_motors),
            ):
                if name is None:
                    continue
                joint = scene.index("joint", prefix + name, robot)
                q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
                joints.append((i, q - self._base, v - self._base_velocity))
                actuator = robot.actuator_of(name)
                if actuator is not None:
                    number = scene.index("actuator", prefix + actuator.name, robot)
                    motors.append((i, number))
        both = self._spin + self._steering
        last_q = max((q for _, q, _ in both), default=6)
        last_v = max((v for _, _, v in both), default=5)
        self._qpos = slice(self._base, self._base + last_q + 1)
        self._qvel = slice(self._base_velocity, self._base_velocity + last_v + 1)
        self._voltages: list[tuple[int, int, float]] = []
        if open_loop:
            self._open_loops()
        # What the servos lag behind set points that move (s): their damping over stiffness.
        self._drives = tuple((i, m, self._lag(m)) for i, m in self._drive_motors)
        self._steerings = tuple((i, m, self._lag(m)) for i, m in self._steering_motors)
        self._asked: JointCommands | None = None
        self._asked_at = 0.0

    def read(self, now: float) -> JointStates:
        self.scene.advance(now)
        data, ratios, offsets = self.scene.data, self._ratios, self._offsets
        # Lists: plain numbers come out of them several times as fast as out of arrays.
        qpos, qvel = data.qpos[self._qpos].tolist(), data.qvel[self._qvel].tolist()
        speeds, positions = [0.0] * self._n, [0.0] * self._n
        angles, rates = [0.0] * self._n, [0.0] * self._n
        for i, q, v in self._spin:
            positions[i] = qpos[q] / ratios[i]
            speeds[i] = qvel[v] / ratios[i]
        for i, q, v in self._steering:
            angles[i] = qpos[q] - offsets[i]
            rates[i] = qvel[v]
        return JointStates(self.scene.time, speeds, angles, rates, positions)

    def write(self, commands: JointCommands, now: float) -> None:
        """Servos with their set points' rates fed forward, as motor controllers have them.

        Without, drives follow a ramp 0.1 s later and steering 0.02 s: while a robot turns
        into a curve its wheels would roll at speeds of one motion in the directions of another.
        """
        ctrl = self.scene.data.ctrl
        speeds, angles, ratios, offsets = (
            commands.speeds,
            commands.angles,
            self._ratios,
            self._offsets,
        )
        before, dt = self._asked, now - self._asked_at
        self._asked, self._asked_at = commands, now
        if before is None or not 0.0 < dt <= LONGEST_STEP:
            before, dt = commands, 1.0
        last_speeds, last_angles = before.speeds, before.angles
        for i, motor, lag in self._drives:
            v = speeds[i]
            ctrl[motor] = (v + lag / dt * (v - last_speeds[i])) * ratios[i]
        for i, motor, lag in self._steerings:
            a = angles[i]
            ctrl[motor] = a + lag / dt * (a - last_angles[i]) + offsets[i]
        for i, joint, slope in self._voltages:
            self.scene.data.qfrc_applied[joint] = slope * commands.speeds[i] * self._ratios[i]

    def expect_single_commands(self) -> None:
        """Nothing is fed forward any more: a step's length is not told."""
        self._drives = tuple((i, motor, 0.0) for i, motor, _ in self._drives)
        self._steerings = tuple((i, motor, 0.0) for i, motor, _ in self._steerings)

    def _lag(self, motor: int) -> float:
        _, stiffness, damping = self.scene.model.actuator_biasprm[motor, :3].tolist()
        return damping / stiffness if stiffness else 0.0

    def _open_loops(self) -> None:
        """Make dampers of the drives' servos; ``write`` adds the torque of the voltage."""
        model = self.scene.model
        joints = {i: v for i, _, v in self._spin}
        for i, motor in self._drive_motors:
            actuator = self.robot.actuator_of(self.robot.wheels[i].spin_joint)
            if actuator is None:
                continue
            slope = actuator.max_torque / actuator.max_velocity
            model.actuator_gainprm[motor] = 0.0
            model.actuator_biasprm[motor] = 0.0
            model.actuator_biasprm[motor, 2] = -slope
            self._voltages.append((i, self._base_velocity + joints[i], slope))

    # -- what only a simulation knows ----------------------------------------------

    def true_pose(self) -> Pose2:
        """As promised; yaw in -pi..pi."""
        x, y, _, w, i, j, k = self._base_position()
        yaw = math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
        return Pose2(x, y, yaw)

    def place(self, pose: Pose2) -> None:
        """Put the robot there, as high, upright and fast as it is."""
        data, start = self.scene.data, self._base
        w, i, j, k = data.qpos[start + 3 : start + 7].tolist()
        turn = (pose.yaw - self.true_pose().yaw) / 2.0
        c, s = math.cos(turn), math.sin(turn)
        turned = (c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w)
        data.qpos[start : start + 2] = pose[:2]
        data.qpos[start + 3 : start + 7] = turned
        self.scene.forward()

    def true_twist(self) -> Twist:
        v = self.scene.data.qvel[self._base_velocity : self._base_velocity + 6].tolist()
        yaw = self.true_pose().yaw
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(c * v[0] + s * v[1], c * v[1] - s * v[0], v[5])

    def posture(self) -> tuple[float, float, float]:
        _, _, z, w, i, j, k = self._base_position()
        roll = math.atan2(2.0 * (w * i + j * k), 1.0 - 2.0 * (i * i + j * j))
        return z, roll, math.asin(min(max(2.0 * (w * j - k * i), -1.0), 1.0))

    def uprightness(self) -> float:
        _, _, _, _, i, j, _ = self._base_position()
        return 1.0 - 2.0 * (i * i + j * j)

    def leaning(self) -> str:
        _, _, _, w, i, j, k = self._base_position()
        # How far the robot's own x and y point up.
        x, y = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i)
        if abs(x) > abs(y):
            return "forwards" if x < 0.0 else "backwards"
        return "to its left" if y < 0.0 else "to its right"

    def _base_position(self) -> list[float]:
        # Read from qpos: MuJoCo's xpos lags a step behind it.
        found: list[float] = self.scene.data.qpos[self._base : self._base + 7].tolist()
        return found


def _load(folder: Path, scene: str, visuals: bool, prepare: Prepare) -> Any:
    import mujoco

    path = folder / scene
    if not path.is_file():
        raise DiagnosticError(
            "simulation-scene",
            f"there is no {scene} in {folder}",
            hint="build the robot with --target mjcf first",
        )
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = not visuals
        spec.compiler.fusestatic = not visuals
        if prepare is not None:
            prepare(spec)
        return spec.compile()
    except ValueError as fault:
        text = str(fault).replace(f"{folder}/", "").strip().replace("\n", "; ")
        raise DiagnosticError("simulation-scene", f"MuJoCo cannot read {scene}: {text}") from fault


def _load_from_memory(
    files: Mapping[str, bytes], scene: str, visuals: bool, prepare: Prepare
) -> Any:
    # MuJoCo's own virtual files are told apart by their base names alone, which robots
    # of a fleet share; a folder that lives as long as the reading does has no such trap.
    with tempfile.TemporaryDirectory(prefix="thorvaldc_") as folder:
        for name, data in files.items():
            parts = PurePosixPath(name).parts
            if "mjcf" not in parts and "meshes" not in parts:
                continue
            path = Path(folder, *parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return _load(Path(folder), scene, visuals, prepare)
