"""Robots in MuJoCo as environments of Gymnasium, for learning and for experiments in a loop.

Needs the extra ``thorvaldc[gym]``.  ``RobotEnv`` takes a model and its MJCF files;
``gymnasium.make("thorvaldc.environments:thorvaldc/Robot-v0", file="robot.yaml")`` compiles
them first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.fleet import Fleet
from thorvaldc.model.scenario import Scenario
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.driver_parameters import Parameters
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.gym.joint_actions import DirectCommands, JointActions
from thorvaldc.simulation.manoeuvre import Manoeuvre, Segment
from thorvaldc.simulation.physics.collision_counter import CollisionCounter
from thorvaldc.simulation.physics.mujoco_base import MujocoBase, MujocoScene
from thorvaldc.simulation.physics.scenario_base import ScenarioBase

try:
    import gymnasium
except ImportError:
    raise ImportError(
        "an environment needs Gymnasium, which is not installed: pip install 'thorvaldc[gym]'"
    ) from None

if TYPE_CHECKING:
    from thorvaldc.simulation.pictures.video import BoundingBoxes

ACTIONS = ("twist", "joints")
LARGEST = 1e6
"""Bound of every observation, in SI; what is beyond, or no number, is brought within."""
DURATION = 20.0
"""Length of an episode (s) of what is no scenario."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Transition:
    """A step, for a reward: the action (-1..1), the robot before and after it.

    ``duration`` is in s, ``collisions`` how often it came to touch what it must not in
    this step, ``terminated`` whether it fell over or the simulation diverged.
    """

    action: Array
    before: Sample
    after: Sample
    duration: float
    collisions: int
    terminated: bool


Reward = Callable[[Transition], float]


class RobotEnv(gymnasium.Env[Array, NDArray[np.float32]]):
    """One robot of a scene, driven by actions of -1..1.

    ``action="twist"``: vx, vy, wz over the driver's largest, through the base driver with its
    limits and ramps.  ``action="joints"``: of each driven wheel its speed over the largest of
    its motor, then of each steered wheel its angle over the larger of its limits (over pi
    where it has none), in the order of ``Robot.wheels``; what is beyond a limit is cut off.
    An action takes effect with the driver's next tick and holds for the step.

    An observation is what the robot itself knows, in SI, by ``observation_names``: the
    odometry's twist and its pose from the start on, the speed of each driven and the angle of
    each steered wheel.  ``info`` has the truth: ``time``, ``true_pose`` (x, y, yaw in the
    scene), ``true_twist``, ``tilt``, ``collisions`` so far, and ``cause`` at the end
    (``tipped``, ``diverged`` or ``time``).  The reward is 0 without a function for it.

    An episode is terminated when the robot falls over or the simulation diverges, and
    truncated after ``duration``.  All chance comes from the seed of ``reset``: where in
    ``spread`` it starts, and the noise of a scenario.
    """

    # What Gymnasium asks of a class; each environment has its own, with its rate.
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        model: Robot | Fleet | Scenario,
        files: Path | str | Mapping[str, bytes],
        *,
        robot: str = "",
        action: str = "twist",
        rate: float = 10.0,
        duration: float = 0.0,
        reward: Reward | None = None,
        spread: Sequence[float] = (0.0, 0.0, 0.0),
        parameters: str | None = None,
        render_mode: str | None = None,
        size: tuple[int, int] = (640, 360),
    ) -> None:
        """``files`` are a build folder, or the outputs of the ``mjcf`` backend for the model.

        ``robot`` names the one that acts, by default the first; others follow a scenario's
        script.  ``rate`` (Hz) is that of the steps, to the nearest whole number of the
        driver's ticks.  ``duration`` (s) is a scenario's own or ``DURATION`` where it is 0.
        ``spread``: how far from the model's place it may start, along its own x and y (m) and
        in yaw (rad).  ``parameters`` names the parameter set that the robot drives by.

        Raises ``DiagnosticError`` where the scene is not of the model, ``PictureError`` where
        pictures are asked for and nothing here draws, ``ValueError`` for other arguments.
        """
        _check(action, rate, duration, spread, render_mode)
        self.render_mode = render_mode
        if render_mode is not None:
            # Before MuJoCo is imported, which looks only once for what it draws by.
            from thorvaldc.simulation.pictures.opengl_backend import choose_opengl_backend

            choose_opengl_backend()
        self.scenario = model if isinstance(model, Scenario) else None
        fleet = model.fleet if isinstance(model, Scenario) else model
        self.robots = (
            {p.name: p.robot for p in fleet.placements}
            if isinstance(fleet, Fleet)
            else {fleet.name: fleet}
        )
        self.name = robot or next(iter(self.robots), "")
        if self.name not in self.robots:
            raise ValueError(f"there is no robot {self.name!r}; there are {', '.join(self.robots)}")
        self.robot = self.robots[self.name]
        self.parameters = parameters
        settings = Parameters.from_robot(self.robot, parameters).settings
        self.scene = MujocoScene(files)
        self.reward = reward
        self.spread = tuple(spread)
        ticks = max(1, round(self.robot.driver.rate / rate))
        self.period = ticks / self.robot.driver.rate
        own = self.scenario.duration if self.scenario is not None else DURATION
        self.duration = duration or own
        self.metadata = {**type(self).metadata, "render_fps": round(1.0 / self.period)}
        self._limits = (
            settings.max_linear_velocity,
            settings.max_linear_velocity,
            settings.max_angular_velocity,
        )
        self._action = action
        self._joints = JointActions(self.robot)
        self.action_names, self.observation_names = _names(self.robot, action)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.action_names),), np.float32)
        self.observation_space = gymnasium.spaces.Box(
            -LARGEST, LARGEST, (len(self.observation_names),), np.float64
        )
        self._bases: list[ScenarioBase] = []
        self._meters: list[ControlLoop] = []
        self._steps = 0
        self._files, self._size = files, size
        self._drawing: _Drawing | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode.  ``options["offset"]`` (x, y in m, yaw in rad) is where the robot
        starts as seen from the model's place, instead of a draw within ``spread``."""
        super().reset(seed=seed)
        draw = self.np_random.uniform(-1.0, 1.0, 3)
        chance = int(self.np_random.integers(2**31))
        offset = (options or {}).get("offset")
        x, y, yaw = offset if offset is not None else draw * self.spread
        self._release()
        self.scene.reset()
        self._meters = [self._meter(name, chance) for name in self.robots]
        acting = self._acting
        if x or y or yaw:
            base = acting.base
            if isinstance(base, MujocoBase):
                base.place(base.true_pose().moved(Pose2(float(x), float(y), float(yaw))))
                acting.start = acting.pose_true = base.true_pose()
        self._contacts = CollisionCounter(self.scene, self.robots)
        self._steps = 0
        self._advance(0.0)
        return self._observation(), self._info("")

    def step(self, action: NDArray[np.float32]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        acting = self._acting
        asked = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        if asked.shape != self.action_space.shape or not np.isfinite(asked).all():
            raise ValueError(f"an action is {self.action_space.shape} finite numbers")
        if self._action == "twist":
            twist = Twist(*(float(a) * limit for a, limit in zip(asked, self._limits, strict=True)))
            acting.manoeuvre = (Segment(-math.inf, twist),)
        else:
            self._joints.set(asked)
        before, collisions = acting.sample(), self._contacts.collisions[self.name]
        self._steps += 1
        self._advance(self._steps * self.period)
        cause = "diverged" if self.scene.diverged else "tipped" if acting.tipped else ""
        terminated = bool(cause)
        truncated = not terminated and self._steps * self.period > self.duration - 1e-9
        info = self._info(cause or ("time" if truncated else ""))
        reward = 0.0
        if self.reward is not None:
            hits = info["collisions"] - collisions
            done = Transition(asked, before, acting.sample(), self.period, hits, terminated)
            reward = float(self.reward(done))
        return self._observation(), reward, terminated, truncated, info

    def render(self) -> Any:
        """The scene as it is, (height, width, 3) bytes; ``None`` without a render mode."""
        if self.render_mode is None:
            return None
        if self._drawing is None:
            self._drawing = _Drawing(self._files, self._size)
        return self._drawing.picture(self.scene)

    def close(self) -> None:
        self._release()
        if self._drawing is not None:
            self._drawing.close()
            self._drawing = None

    # -- parts --------------------------------------------------------------------------

    @property
    def _acting(self) -> ControlLoop:
        for meter in self._meters:
            if meter.name == self.name:
                return meter
        raise DiagnosticError("simulation-scene", "the environment was not reset")

    def _meter(self, name: str, chance: int) -> ControlLoop:
        robot, scenario = self.robots[name], self.scenario
        base: MujocoBase
        plan: Manoeuvre = ()
        if scenario is None:
            base = MujocoBase(robot, self.scene)
        else:
            faults = [fault for fault in scenario.faults if fault.robot == name]
            noise = replace(scenario.noise, seed=chance)
            zones = scenario.fleet.world.zones if scenario.fleet.world is not None else ()
            base = ScenarioBase(robot, self.scene, faults, noise, zones)
            self._bases.append(base)
            for other, commands in scenario.commands:
                if other == name:
                    plan = tuple(Segment(c.time, Twist(c.vx, c.vy, c.wz)) for c in commands)
        if name != self.name:
            return ControlLoop(name, robot, base, plan)
        meter = ControlLoop(name, robot, base, (), self.parameters)
        if self._action == "joints":
            self._joints.reset()
            direct = DirectCommands(meter.driver.calculator, self._joints.commands)
            meter.driver = BaseDriver(robot, base, direct, parameters=self.parameters)
        return meter

    def _advance(self, end: float) -> None:
        while not self.scene.diverged:
            meter = min(self._meters, key=lambda m: m.next_time)
            if meter.next_time > end + 1e-9:
                return
            meter.tick()
            self._contacts.update()

    def _release(self) -> None:
        """Take back what faults changed in the scene."""
        while self._bases:
            self._bases.pop().close()

    def _observation(self) -> Array:
        state = self._acting.driver.state
        found: list[float] = [*state.odometry.twist, *state.pose]
        if state.joints is not None:
            found += [state.joints.speeds[i] for i, _ in self._joints.driven]
            found += [state.joints.angles[i] for i, _, _, _ in self._joints.steered]
        values = np.zeros(len(self.observation_names))
        values[: len(found)] = found
        return np.clip(np.nan_to_num(values), -LARGEST, LARGEST)

    def _info(self, cause: str) -> dict[str, Any]:
        acting = self._acting
        sample = acting.sample()
        info: dict[str, Any] = {
            "time": self._steps * self.period,
            "true_pose": np.array(sample.pose_true),
            "true_twist": np.array(sample.true),
            "tilt": math.acos(max(-1.0, min(1.0, acting.uprightness))),
            "collisions": self._contacts.collisions[self.name],
        }
        return {**info, "cause": cause} if cause else info


def _check(
    action: str, rate: float, duration: float, spread: Sequence[float], render_mode: str | None
) -> None:
    if action not in ACTIONS:
        raise ValueError(f"the action is {action!r}; it must be {' or '.join(ACTIONS)}")
    if not 0.0 < rate < math.inf:
        raise ValueError(f"the rate is {rate:g} Hz; it must be positive")
    if not 0.0 <= duration < math.inf:
        raise ValueError(f"the duration is {duration:g} s; it must not be negative")
    if len(spread) != 3 or not all(0.0 <= part < math.inf for part in spread):
        raise ValueError("the spread is that of x, y and yaw, none of them negative")
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"the render mode is {render_mode!r}; it must be rgb_array or None")


def _names(robot: Robot, action: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What the entries of an action and of an observation are."""
    speeds = [f"{w.name}_speed" for w in robot.wheels if w.driven]
    angles = [f"{w.name}_angle" for w in robot.wheels if w.steered]
    twist = ("vx", "vy", "wz")
    asked = twist if action == "twist" else (*speeds, *angles)
    return asked, (*twist, "x", "y", "yaw", *speeds, *angles)


class _Drawing:
    """Pictures of a scene, from a copy of it with all that is seen; the camera follows."""

    def __init__(self, files: Path | str | Mapping[str, bytes], size: tuple[int, int]) -> None:
        from thorvaldc.simulation.pictures.render import View, picture_scene, renderer
        from thorvaldc.simulation.pictures.video import BoundingBoxes

        self._view = View()
        self._scene = picture_scene(files, size, self._view, quick=True)
        self._aspect = size[0] / size[1]
        self._boxes: BoundingBoxes = BoundingBoxes(self._scene)
        # As far as a robot drives in a while, and the ground on the way.
        around = self._boxes.corners(self._scene)
        around = np.vstack([around.min(axis=0) - 20.0, around.max(axis=0) + 20.0])
        self._open = ExitStack()
        self._renderer = self._open.enter_context(renderer(self._scene, size, around))
        self._distance = 0.0

    def picture(self, scene: MujocoScene) -> Any:
        from thorvaldc.simulation.pictures.render import fit_camera

        self._scene.data.qpos[:] = scene.data.qpos
        self._scene.forward()
        camera = fit_camera(self._boxes.corners(self._scene), self._view, self._aspect)
        # Steady: a robot that turns or steers does not come nearer.
        self._distance = camera.distance = max(self._distance, camera.distance)
        self._renderer.update_scene(self._scene.data, camera)
        return self._renderer.render()

    def close(self) -> None:
        self._open.close()
