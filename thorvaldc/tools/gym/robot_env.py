"""Gymnasium environment of a robot in MuJoCo, for learning and closed-loop experiments.

This module requires the extra ``thorvaldc[gym]``.  ``RobotEnv`` loads a model and the MJCF files
of the model.  To compile a robot file first, call
``gymnasium.make("thorvaldc.tools.gym.environments:thorvaldc/Robot-v0", file="robot.yaml")``.
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

from thorvaldc.compiler.source.overrides import Range
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import Scenario
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.episode import Episode
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

if TYPE_CHECKING:
    from thorvaldc.simulation.pictures.render import BoundingBoxes


Array = NDArray[np.float64]
Step = tuple[Array, float, bool, bool, dict[str, Any]]
"""Observation, reward, terminated, truncated, info."""


class JointActions:
    """Converts an action of a Gymnasium environment to joint commands.

    Each value of an action is between -1 and 1.  The first values of an action are the speeds of
    the driven wheels, and the other values are the angles of the steered wheels.
    """

    def __init__(self, robot: Robot) -> None:
        self._wheels = len(robot.wheels)
        # ``driven`` has (wheel, largest speed in rad/s) for each driven wheel.  ``steered`` has
        # (wheel, scale, lower limit, upper limit) in rad for each steered wheel.
        self.driven: list[tuple[int, float]] = []
        self.steered: list[tuple[int, float, float, float]] = []
        for i, wheel in enumerate(robot.wheels):
            motor = robot.actuator_of(wheel.spin_joint)
            if wheel.driven and motor is not None:
                self.driven.append((i, motor.max_velocity))
            if wheel.steering_joint is not None:
                joint = robot.joint(wheel.steering_joint)
                lower = -math.inf if joint.lower is None else joint.lower
                upper = math.inf if joint.upper is None else joint.upper
                scale = max(abs(lower), abs(upper))
                scale = scale if math.isfinite(scale) else math.pi
                self.steered.append((i, scale, lower, upper))

    def commands(self, action: Array) -> JointCommands:
        """Returns the joint commands of an action."""
        speeds, angles = [0.0] * self._wheels, [0.0] * self._wheels
        values = action.tolist()
        for (i, largest), value in zip(self.driven, values, strict=False):
            speeds[i] = value * largest
        for (i, scale, _, _), value in zip(self.steered, values[len(self.driven) :], strict=True):
            angles[i] = value * scale
        return JointCommands(speeds, angles)


SPEED_MARGIN = 1.5
"""Largest wheel speed, as a multiple of the largest speed of its motor.

Wheels that work against each other drag a wheel beyond the speed of its motor.
"""
ANGLE_MARGIN = 0.1
"""Largest steering angle beyond a steering limit, rad."""


def observation_bounds(
    robot: Robot, joints: JointActions, start: Pose2, spread: Sequence[float], duration: float
) -> NDArray[np.float64]:
    """Returns the largest absolute value of each observation, in SI units.

    - ``start``: start pose of the robot in the scene.
    - ``spread``: largest random offset of the start pose, in m, m and rad.
    - ``duration``: duration of an episode, s.

    The twist about the centroid of the wheels is a least-squares fit to wheel speeds of at most V
    m/s.  Its velocity is at most V, and its yaw rate at most V / L, where L is the root mean square
    distance of the wheels from the centroid.  The pose is bounded by the twist and the duration.
    Joints that contradict each other can give a larger estimated twist, which has no meaning.
    """
    geometry = BaseGeometry.from_robot(robot)
    radii = [robot.wheels[i].radius for i, _ in joints.driven]
    speeds = [SPEED_MARGIN * speed for _, speed in joints.driven]
    largest = max((r * speed for r, speed in zip(radii, speeds, strict=True)), default=1.0)
    turning = largest / geometry.length
    linear = largest + turning * math.hypot(*geometry.centre)
    distance = math.hypot(spread[0], spread[1]) + linear * duration
    angles = []
    for i, _, lower, upper in joints.steered:
        limit = max(abs(lower), abs(upper)) + ANGLE_MARGIN
        if not math.isfinite(limit):
            limit = math.pi + geometry.wheels[i].max_rate * duration
        angles.append(limit)
    return np.array(
        [
            *(linear, linear, turning),
            *(abs(start.x) + distance, abs(start.y) + distance),
            abs(start.yaw) + spread[2] + turning * duration,
            *speeds,
            *angles,
        ]
    )


try:
    import gymnasium
except ImportError:
    raise ImportError(
        f"an environment needs Gymnasium, which is not installed: {install_command('gym')}"
    ) from None


ACTIONS = ("twist", "joints")
DURATION = 20.0
"""Default duration of an episode (s)."""


@dataclass(frozen=True, slots=True)
class Transition:
    """The data of one step of the environment, which a reward function receives.

    * ``action``: values of the action, in -1..1.
    * ``before``: sample of the robot before the step.
    * ``after``: sample of the robot after the step.
    * ``duration``: duration of the step (s).
    * ``collisions``: number of collisions that began in the step.
    * ``terminated``: true if the robot fell over, the simulation diverged, or ``terminates`` said
      so.
    """

    action: Array
    before: Sample
    after: Sample
    duration: float
    collisions: int
    terminated: bool


Reward = Callable[[Transition], float]
Terminates = Callable[[Transition], bool]
Model = Robot | Fleet | Scenario
Recompile = Callable[[Mapping[str, object]], tuple[Model, Mapping[str, bytes]]]
"""A function that returns a model with new values by their paths, and its MJCF files."""
Choice = tuple[object, object] | list[Any] | Callable[[np.random.Generator], object]
"""A range of a value (two numbers or quantities), listed values, or a function that draws one."""


class RobotEnv(gymnasium.Env[Array, NDArray[np.float32]]):
    """A Gymnasium environment in which actions control one robot of a MuJoCo scene.

    Action: all values are in -1..1.

    * With ``action="twist"`` the values are vx, vy and wz, each divided by the largest value that
      the driver allows.  The base driver applies its limits and ramps to the twist.
    * With ``action="joints"`` the first values are the speeds of the driven wheels, each divided by
      the largest speed of the motor.  The other values are the angles of the steered wheels, each
      divided by the larger steering limit, or by pi for a wheel without steering limits.  The
      wheels are in the order of ``Robot.wheels``.  A steering angle beyond a steering limit is
      clipped.  The joint commands bypass the base calculator of the driver.

    The driver ticks at a separate rate between two steps of the environment.  An action takes
    effect at the next tick of the driver and holds until the next step.

    Observation: the values are in SI units, in the order of ``observation_names``.  An observation
    contains only values that the robot can measure.  The values are the twist of the odometry, the
    pose of the odometry in the scene, the speed of each driven wheel, and the angle of each steered
    wheel.  The odometry starts at the true start pose, as on a robot that is localised once at the
    start.  The bounds of ``observation_space`` follow from the limits of the robot, and values
    beyond the bounds are clipped.

    Own observations: ``observe`` returns the observation of the environment, which has the space
    ``observation_space``, for example from ``env.episode.sensors["lidar"].latest``.

    Info: the mapping ``info`` contains the true state of the simulation.

    * ``time``: time since the start of the episode (s).
    * ``true_pose``: x (m), y (m) and yaw (rad) in the scene.
    * ``true_twist``: vx, vy (m/s) and wz (rad/s).
    * ``tilt``: largest tilt angle since the start of the episode (rad).
    * ``collisions``: number of collisions since the start of the episode.
    * ``cause``: reason for the end of the episode, ``tipped``, ``diverged``, ``ended`` by
      ``terminates``, or ``time``.

    Reward: the value of the function ``reward``, or 0 without a reward function.

    Domain randomisation: with ``randomize``, each ``reset`` draws new values for entries of the
    file, such as ``{"world.friction": (0.3, 0.8), "faults.0.error": ("-1 %", "1 %")}``, and
    compiles the robots and the world with them.  The ``info`` of ``reset`` then has ``values``.

    An episode is terminated when the robot falls over, the simulation diverges, or the function
    ``terminates`` says so.  An episode is truncated after ``duration`` s.  The random start pose
    and the noise of a scenario depend only on the seed of ``reset``.
    """

    # Gymnasium requires this class attribute; each instance has its own with its rate.
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        model: Model,
        files: Path | str | Mapping[str, bytes] | None = None,
        *,
        robot: str = "",
        action: str = "twist",
        rate: float = 10.0,
        duration: float = 0.0,
        reward: Reward | None = None,
        terminates: Terminates | None = None,
        observe: Callable[[RobotEnv], Any] | None = None,
        observation_space: gymnasium.Space[Any] | None = None,
        spread: Sequence[float] = (0.0, 0.0, 0.0),
        parameters: str | None = None,
        render_mode: str | None = None,
        size: tuple[int, int] = (640, 360),
        scene: MujocoScene | None = None,
        randomize: Mapping[str, Choice] | None = None,
        recompile: Recompile | None = None,
    ) -> None:
        """Loads the MuJoCo scene of the environment.

        * ``files``: a build folder, or the outputs of the ``mjcf`` backend for the model.  By
          default they are generated.
        * ``robot``: name of the robot that the actions control.  By default, the actions control
          the first robot.  All other robots follow the script of the scenario.
        * ``action``: kind of the actions, ``twist`` or ``joints``.
        * ``rate``: number of steps per second (Hz).  The duration of a step is rounded to a whole
          number of driver ticks.
        * ``duration``: duration of an episode (s).  The value 0 selects the duration of the
          scenario, or ``DURATION`` without a scenario.
        * ``reward``: function that computes the reward of a step.
        * ``terminates``: function that tells whether a step ends the episode, as at a goal.
        * ``observe``, ``observation_space``: function that returns an observation, and its space.
        * ``spread``: largest random offset of the start pose, in x (m), y (m) and yaw (rad) of the
          robot.
        * ``parameters``: name of the parameter set of the driver.
        * ``render_mode``: ``rgb_array``, or ``None`` for an environment without pictures.
        * ``size``: width and height of a picture in pixels.
        * ``scene``: scene of ``files`` that was loaded before.  By default, it is loaded.
        * ``randomize``: values that ``reset`` draws, by their paths in the file, as in the option
          ``--set``: a tuple of two limits, a list, or a function of a generator of numpy.
        * ``recompile``: function that compiles the file with new values; ``gymnasium.make`` gives
          it.

        Raises ``DiagnosticError`` if the scene does not belong to the model.  Raises
        ``PictureError`` if a render mode is set and MuJoCo cannot draw.  Raises ``ValueError`` if
        an argument is invalid.
        """
        _check(action, rate, duration, spread, render_mode)
        self.render_mode = render_mode
        prepare_drawing(render_mode)
        self._drawn = {path: _draw(path, choice) for path, choice in (randomize or {}).items()}
        self._recompile = recompile
        if self._drawn and (recompile is None or scene is not None):
            raise ValueError(
                "`randomize` needs a file that is compiled anew, as in `gymnasium.make(...,"
                " file=FILE)` and `make_vec(..., vectorization_mode='sync')`; a batch has one model"
            )
        self._parameters, self._action = parameters, action
        self._values: dict[str, object] = {}
        self._duration = duration
        if (observe is None) != (observation_space is None):
            raise ValueError("`observe` needs the `observation_space` of its observations")
        self.reward, self.terminates, self.observe = reward, terminates, observe
        self.spread = tuple(spread)
        self.episode = Episode(model, files, parameters, robot=robot, scene=scene)
        self.name = self.episode.name
        self._use_robot()
        ticks = max(1, round(self.robot.driver.rate / rate))
        self.period = ticks / self.robot.driver.rate
        self.metadata = {**type(self).metadata, "render_fps": round(1.0 / self.period)}
        self.action_names, self.observation_names = _names(self.robot, action)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.action_names),), np.float32)
        start = self.episode.starts[self.name]
        self._bounds = observation_bounds(
            self.robot, self._joints, start, self.spread, self.duration
        )
        self.observation_space = observation_space or gymnasium.spaces.Box(
            -self._bounds, self._bounds, dtype=np.float64
        )
        self._steps = 0
        self._start: tuple[Array, Sample, int] | None = None
        self._size = size
        self._drawing: _Drawing | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode and returns the first observation and ``info``.

        ``options["offset"]`` (x in m, y in m, yaw in rad) replaces the random offset of the start
        pose, ``options["set"]`` values of the file by their paths.  Raises ``ValueError`` for
        another option, and if the file with the values has errors or other wheels.
        """
        super().reset(seed=seed)
        for option in options or {}:
            if option not in ("offset", "set"):
                raise ValueError(f"`reset` has the options 'offset' and 'set', not {option!r}")
        values = {path: draw(self.np_random) for path, draw in self._drawn.items()}
        changes = (options or {}).get("set") or {}
        if not isinstance(changes, Mapping):
            raise ValueError(f"'set' is {changes!r}; it must be values by their paths in the file")
        values |= changes
        if values or self._values:  # or those of the last reset
            self._compile_with(values)
        random_offset = self.np_random.uniform(-1.0, 1.0, 3) * self.spread
        noise_seed = int(self.np_random.integers(2**31))
        offset = (options or {}).get("offset")
        if offset is not None and (np.shape(offset) != (3,) or not np.isfinite(offset).all()):
            raise ValueError(f"the offset is {offset!r}; it must be x (m), y (m) and yaw (rad)")
        x, y, yaw = offset if offset is not None else random_offset
        episode = self.episode
        episode.begin(noise_seed)
        loop = episode.loops[self.name]
        if x or y or yaw:
            loop.place(loop.start.moved(Pose2(float(x), float(y), float(yaw))))
        # The script of a scenario moves the other robots alone.
        self._command(np.zeros(len(self.action_names)))
        self._steps = 0
        self._advance()
        info = self._info("")
        return self._observation(), {**info, "values": values} if values else info

    def _compile_with(self, values: Mapping[str, object]) -> None:
        """Replaces the episode by one of the file with new values."""
        if self._recompile is None:
            raise ValueError("new values need a file: gymnasium.make(..., file=FILE)")
        self.close()
        self._values = {**values}
        self.episode = Episode(*self._recompile(values), self._parameters, robot=self.name)
        self._use_robot()
        if _names(self.robot, self._action) != (self.action_names, self.observation_names):
            raise ValueError(f"the wheels of {self.name} are others with the values {values}")

    def _use_robot(self) -> None:
        """Reads the limits and the joints of the controlled robot."""
        self.robot = self.episode.robots[self.name]
        settings = Parameters.from_robot(self.robot, self._parameters).settings
        scenario = self.episode.scenario
        default = scenario.duration if scenario is not None else DURATION
        self.duration = self._duration or default
        linear = settings.max_linear_velocity
        self._limits = (linear, linear, settings.max_angular_velocity)
        self._joints = JointActions(self.robot)

    def step(self, action: NDArray[np.float32]) -> Step:
        self.start_step(action)
        self._advance()
        return self.finish_step()

    def start_step(self, action: NDArray[np.float32]) -> None:
        """Commands an action, and starts the time of its step.

        A step is ``start_step``, then ``episode.tick`` for each loop of ``due``, then
        ``finish_step``.  Between the two, the scenes of several environments can advance together.
        """
        loop = self._controlled
        values = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            raise ValueError(f"an action must be {self.action_space.shape} finite numbers")
        self._command(values)
        self._start = values, loop.sample(), self._collisions
        self._steps += 1

    def _command(self, values: Array) -> None:
        if self._action == "joints":
            self.episode.command(self._joints.commands(values))
        else:
            limited = zip(values, self._limits, strict=True)
            self.episode.command(Twist(*(float(value) * limit for value, limit in limited)))

    def due(self) -> ControlLoop | None:
        """Returns the control loop that ticks next, or ``None`` at the end of the step."""
        return self.episode.due(self._steps * self.period)

    def finish_step(self) -> Step:
        """Returns the observation, the reward and the rest of the result of a step."""
        if self._start is None:
            raise DiagnosticError("simulation-scene", "the environment was not stepped")
        loop, (values, before, collisions) = self._controlled, self._start
        cause = "diverged" if self.episode.diverged else "tipped" if loop.tipped else ""
        new_collisions = self._collisions - collisions
        step = Transition(values, before, loop.sample(), self.period, new_collisions, bool(cause))
        if not cause and self.terminates is not None and self.terminates(step):
            cause, step = "ended", replace(step, terminated=True)
        terminated = step.terminated
        truncated = not terminated and self._steps * self.period > self.duration - 1e-9
        info = self._info(cause or ("time" if truncated else ""))
        reward = 0.0 if self.reward is None else float(self.reward(step))
        return self._observation(), reward, terminated, truncated, info

    def render(self) -> Any:
        """Returns a picture as an array of bytes with the shape (height, width, 3).

        Returns ``None`` if the environment has no render mode.
        """
        if self.render_mode is None:
            return None
        if self._drawing is None:
            if self.episode.files is None:
                raise DiagnosticError("simulation-scene", "the environment has no files to draw")
            self._drawing = _Drawing(self.episode.files, self._size)
        return self._drawing.picture(self.scene)

    def close(self) -> None:
        self.episode.close()
        if self._drawing is not None:
            self._drawing.close()
            self._drawing = None

    # -- parts --------------------------------------------------------------------------

    @property
    def scene(self) -> MujocoScene:
        """The MuJoCo scene of the environment."""
        if self.episode.scene is None:
            raise DiagnosticError("simulation-scene", "the environment has no scene")
        return self.episode.scene

    @property
    def _controlled(self) -> ControlLoop:
        """The control loop of the robot that the actions control."""
        if not self.episode.loops:
            raise DiagnosticError("simulation-scene", "the environment was not reset")
        return self.episode.loops[self.name]

    @property
    def _collisions(self) -> int:
        collisions = self.episode.collisions
        return 0 if collisions is None else collisions.collisions[self.name]

    def _advance(self) -> None:
        """Runs the control loops of all robots until the end of the step."""
        self.episode.advance(self._steps * self.period)

    def _observation(self) -> Any:
        if self.observe is not None:
            return self.observe(self)
        loop = self._controlled
        state = loop.driver.state
        values: list[float] = [*state.odometry.twist, *loop.start.moved(state.pose)]
        if state.joints is not None:
            values += [state.joints.speeds[i] for i, _ in self._joints.driven]
            values += [state.joints.angles[i] for i, _, _, _ in self._joints.steered]
        observation = np.zeros(len(self.observation_names))
        observation[: len(values)] = values
        return np.clip(np.nan_to_num(observation), -self._bounds, self._bounds)

    def _info(self, cause: str) -> dict[str, Any]:
        loop = self._controlled
        sample = loop.sample()
        info: dict[str, Any] = {
            "time": self._steps * self.period,
            "true_pose": np.array(sample.pose_true),
            "true_twist": np.array(sample.true),
            "tilt": math.acos(max(-1.0, min(1.0, loop.uprightness))),
            "collisions": self._collisions,
        }
        return {**info, "cause": cause} if cause else info


def _draw(path: str, choice: Choice) -> Callable[[np.random.Generator], object]:
    """Returns a function that draws a value."""
    if callable(choice):
        return lambda random: np.asarray(choice(random)).item()
    if isinstance(choice, list) and choice:
        return lambda random: choice[int(random.integers(len(choice)))]
    is_pair = isinstance(choice, tuple) and len(choice) == 2
    values = Range.parse(*map(str, choice)) if is_pair else None
    if values is None:
        raise ValueError(
            f"{choice!r} is no range of `{path}`, such as ('0.8 m', '1.2 m'), no list and no"
            " function"
        )
    return lambda random: values.at(float(random.uniform()))


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
        raise ValueError("the spread must be three values (x, y, yaw) that are not negative")
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"the render mode is {render_mode!r}; it must be rgb_array or None")


def prepare_drawing(render_mode: str | None) -> None:
    """Chooses the OpenGL backend, before MuJoCo reads its name during the import."""
    if render_mode is not None:
        from thorvaldc.simulation.pictures.render import choose_opengl_backend

        choose_opengl_backend()


def _names(robot: Robot, action: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns the names of the action values and the names of the observation values."""
    speeds = [f"{w.name}_speed" for w in robot.wheels if w.driven]
    angles = [f"{w.name}_angle" for w in robot.wheels if w.steered]
    twist = ("vx", "vy", "wz")
    action_names = twist if action == "twist" else (*speeds, *angles)
    return action_names, (*twist, "x", "y", "yaw", *speeds, *angles)


class _Drawing:
    """Draws pictures of the MuJoCo scene of the environment.

    The pictures show a copy of the scene with visual geoms.  The camera follows the robots.
    """

    def __init__(self, files: Path | str | Mapping[str, bytes], size: tuple[int, int]) -> None:
        from thorvaldc.simulation.pictures.render import (
            BoundingBoxes,
            View,
            picture_scene,
            renderer,
        )

        self._view = View()
        self._scene = picture_scene(files, size, self._view, quick=True)
        self._aspect = size[0] / size[1]
        self._boxes: BoundingBoxes = BoundingBoxes(self._scene)
        # The renderer requires the extent of the scene.  The extent of the scene includes a margin
        # of 20 m for the motion of the robots.
        corners = self._boxes.corners(self._scene)
        corners = np.vstack([corners.min(axis=0) - 20.0, corners.max(axis=0) + 20.0])
        self._resources = ExitStack()
        self._renderer = self._resources.enter_context(renderer(self._scene, size, corners))
        self._distance = 0.0

    def picture(self, scene: MujocoScene) -> Any:
        from thorvaldc.simulation.pictures.render import fit_camera

        self._scene.data.qpos[:] = scene.data.qpos
        self._scene.forward()
        camera = fit_camera(self._boxes.corners(self._scene), self._view, self._aspect)
        # The camera distance never decreases, so that the camera does not move while a robot turns
        # or steers.
        self._distance = camera.distance = max(self._distance, camera.distance)
        self._renderer.update_scene(self._scene.data, camera)
        return self._renderer.render()

    def close(self) -> None:
        self._resources.close()
