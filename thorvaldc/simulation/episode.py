"""A robot, a fleet or a scenario in simulation, one control cycle after the other."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from thorvaldc.diagnostics import DiagnosticError, did_you_mean
from thorvaldc.model import Fleet, Robot, robots_by_name
from thorvaldc.model.model_json import load_model, to_json
from thorvaldc.model.scenario import Scenario
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import (
    ControlLoop,
    Manoeuvre,
    Sample,
    Segment,
    TickCallback,
)
from thorvaldc.simulation.episode_state import EpisodeState
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import CollisionCounter, MujocoScene
from thorvaldc.simulation.physics.scenario_base import ScenarioBase
from thorvaldc.simulation.physics.sim_base import RollingBase, SimBase, WheelErrors

if TYPE_CHECKING:
    from thorvaldc.model.scenario import SensorSettings
    from thorvaldc.simulation.physics.wheel_contacts import WheelContact
    from thorvaldc.simulation.records.recorder import Recorder
    from thorvaldc.simulation.sensors.sensor_suite import SensorSuite

Command = Twist | JointCommands | Sequence[float] | None
"""A twist, also as three numbers (m/s, m/s, rad/s); joint commands (rad/s, rad); or ``None``: what
the script of the scenario commands, without a scenario zero."""
Controller = Callable[[Sample], Command]
"""A function that returns the command after a sample."""
Motion = Sequence[float] | Sequence[tuple[float, Sequence[float]]]
"""A twist that lasts, or segments: (start in s, twist)."""
_MODEL_FILE = "model.json"
_TOLERANCE = 1e-9
"""Tolerance (s) for rounding errors of times."""
T = TypeVar("T")


class Episode:
    """A robot, a fleet or a scenario in simulation, one control cycle after the other.

    ``reset`` starts it; ``step`` commands a robot and runs one control cycle of it; ``run`` does so
    with a controller until a time.  The driver applies its limits and ramps to a twist.

    >>> import thorvaldc
    >>> robot = thorvaldc.load("examples/4wd4ws_wide/robot.yaml")
    >>> episode = thorvaldc.Episode(robot)  # in MuJoCo; with ideal=True: ideal joints
    >>> sample = episode.reset()
    >>> while sample.pose_true.x < 0.5:  # m
    ...     sample = episode.step(thorvaldc.Twist(0.5, 0.0, 0.0))
    >>> round(sample.time, 1)  # s
    1.3
    """

    def __init__(
        self,
        model: Robot | Fleet | Scenario | Path | str,
        files: Path | str | Mapping[str, bytes] | None = None,
        parameters: str | None = None,
        *,
        ideal: bool = False,
        robot: str = "",
        wheel_errors: Mapping[str, WheelErrors] | None = None,
        open_loop: bool = False,
        sensors: SensorSettings | None = None,
        scene: MujocoScene | None = None,
    ) -> None:
        """Loads the scene of the robots.

        * ``model``: a robot, a fleet, a scenario, or the path of a build folder with the target
          ``mjcf``, which brings its own model.
        * ``files``: a build folder of the model, or the outputs of the ``mjcf`` backend as
          ``{path: bytes}``.  By default they are generated.
        * ``parameters``: name of the parameter set of the drivers.
        * ``ideal``: the robots have ideal joints, and no MuJoCo.
        * ``robot``: name of the robot that ``step`` commands, by default the first one.
        * ``wheel_errors``: errors of the wheels by robot name.  The drivers do not correct the
          wheel errors.
        * ``open_loop``: true if the drive motors apply a voltage without speed control.
        * ``sensors``: settings of the sensors of the modules, which then measure in MuJoCo.
          ``None``: they measure, with the default settings, from the first use of ``sensors`` on.
        * ``scene``: scene of ``files`` that was loaded before.

        With ideal joints, robots with wheel errors or with ``open_loop`` have a ``RollingBase``, in
        which no wheel slips.

        Raises ``DiagnosticError`` if the scene cannot be read, if the scene belongs to another
        model, or if a robot does not have the parameter set ``parameters``, and ``ValueError`` if
        there is no robot with a given name.
        """
        if isinstance(model, (Path, str)):
            files = Path(model)
            if not files.is_dir():
                raise DiagnosticError(
                    "simulation-scene",
                    f"{files} is no folder of a build",
                    hint="build it with --target mjcf, or give the model: thorvaldc.load(FILE), or"
                    " thorvaldc.compile(FILE).scenario",
                )
            model = load_model(files)
        elif not isinstance(model, (Robot, Fleet, Scenario)):
            raise TypeError(f"expected a Robot, Fleet or Scenario, got {type(model).__name__}")
        elif files is not None:
            _check_files(model.fleet if isinstance(model, Scenario) else model, files)
        self.scenario = model if isinstance(model, Scenario) else None
        fleet = model.fleet if isinstance(model, Scenario) else model
        self.robots: dict[str, Robot] = robots_by_name(fleet)
        placements = fleet.placements if isinstance(fleet, Fleet) else ()
        self._own_starts = dict.fromkeys(self.robots, se2.ORIGIN) | {
            p.name: Pose2(p.pose.xyz[0], p.pose.xyz[1], p.pose.rpy()[2]) for p in placements
        }
        self.starts: dict[str, Pose2] = dict(self._own_starts)
        """Start pose (m, rad) of each robot in the world; a change holds from the next reset on."""
        self.name = robot or next(iter(self.robots), "")
        if robot:
            self.check_robot(robot)
        for own in self.robots.values():
            Parameters.from_robot(own, parameters)
        self.parameters = parameters
        self.world = fleet.world if isinstance(fleet, Fleet) else None
        if files is None and not ideal and scene is None:
            files = _generated(fleet)
        if scene is None and files is not None:
            scene = MujocoScene(files)
        self.scene = scene
        self.files = files
        """Files of the scene, or ``None`` with ideal joints."""
        self._sensor_settings = sensors
        self._suite: SensorSuite | None = None
        if sensors is not None:
            _ = self.sensors
        elif self.scenario is not None and self.scenario.sensors is not None:
            # They measure only for a record, or from the first use of ``sensors`` on.
            noise = self.scenario.noise
            self._sensor_settings = replace(self.scenario.sensors, noise=noise)
        for name in wheel_errors or {}:
            self.check_robot(name)
        self.wheel_errors = wheel_errors or {}
        self.open_loop = open_loop or (self.scenario is not None and self.scenario.open_loop)
        self._scripts: dict[str, Manoeuvre] = {}
        self._parameter_changes: dict[str, list[tuple[float, str]]] = {}
        for name, commands in self.scenario.commands if self.scenario is not None else ():
            self._scripts[name] = tuple(Segment(c.time, Twist(c.vx, c.vy, c.wz)) for c in commands)
            changes = [(c.time, c.parameters) for c in commands if c.parameters]
            self._parameter_changes[name] = changes
        self.loops: dict[str, ControlLoop] = {}
        """The control loop of each robot since the last reset."""
        self._schedule: list[tuple[float, int]] = []
        self._in_order: list[ControlLoop] = []
        self._bases: list[ScenarioBase] = []
        self.collisions: CollisionCounter | None = None
        self.time = 0.0
        """Simulated time (s) of the last control cycle."""

    def __repr__(self) -> str:
        names = [*self.robots]
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        physics = "with ideal joints" if self.scene is None else "in MuJoCo"
        return f"<{type(self).__name__} of {shown} {physics}>"

    @property
    def sensors(self) -> SensorSuite:
        """The simulated sensors of the robots by name; in a fleet with the robot: ``r1/lidar``.

        ``sensors["lidar"].latest`` is the last message, and the functions in ``sensors.listeners``
        are called with each sensor and message.  The motion is the same with and without sensors.

        Raises ``DiagnosticError`` for ideal joints, which have no scene to measure.
        """
        if self._suite is None:
            if type(self.scene) not in (MujocoScene, type(None)):
                raise DiagnosticError("simulation-scene", "a world of a batch has no sensors")
            if self.scene is None or self.files is None:
                raise DiagnosticError(
                    "simulation-scene",
                    "sensors need a scene to measure, and ideal joints have none",
                    hint="leave out --ideal; in Python, give `Simulation` files, or use `Episode`",
                )
            # Runs without sensors do not import numpy for them.
            from thorvaldc.model.scenario import SensorSettings
            from thorvaldc.simulation.sensors.sensor_suite import SensorSuite

            settings = self._sensor_settings or SensorSettings()
            robots = [*self.robots.values()]
            self._suite = SensorSuite(self.scene, self.files, robots, settings)
        return self._suite

    def record_sensors(self, recorders: Sequence[Recorder]) -> None:
        """Gives the messages of the sensors to the MCAP recorders, if there are settings of sensors
        or they measure.  Raises ``DiagnosticError`` as ``sensors`` does."""
        if self._sensor_settings is None and self._suite is None:
            return
        from thorvaldc.simulation.records.mcap_writer import McapRecorder

        taking = [r.measured for r in recorders if isinstance(r, McapRecorder)]
        if taking or self._suite is not None:
            self.sensors.recorders = [*taking]

    # -- an episode --------------------------------------------------------------------------------

    def reset(self, seed: int | None = None, state: EpisodeState | None = None) -> Sample:
        """Starts at rest, at the poses ``starts``; returns the sample of the first control cycle.

        ``seed``: seed of the sensor noise of a scenario, by default that of the scenario.
        ``state``: a state that this episode has saved, from which it goes on as it did.
        """
        if state is not None:
            return self._restore(state)
        self.begin(seed)
        self.advance(0.0)
        return self.sample()

    def save(self) -> EpisodeState:
        """Returns the state of the robots, their drivers, the scene and the sensors, for
        ``reset(state=...)``.

        Raises ``DiagnosticError`` if the episode was not started, if its scene is one of a batch,
        or if the driver has a part that cannot be copied, such as an open file of a plug-in.
        """
        self._loop(self.name)
        sensors = None if self._suite is None else self._suite.state
        parts = (self.loops, self._schedule, self._in_order, self._bases, self.collisions, sensors)
        return EpisodeState(self, self.time, parts, self.scene)

    def _restore(self, state: EpisodeState) -> Sample:
        if not isinstance(state, EpisodeState) or state.owner is not self:
            raise DiagnosticError(
                "simulation-scene", "the state is not one that this episode has saved"
            )
        state.restore()
        self.loops, self._schedule, self._in_order, self._bases, self.collisions, sensors = (
            state.parts
        )
        self.time = state.time
        if self._suite is not None and sensors is not None:
            self._suite.state = sensors
        return self.sample()

    def step(self, command: Command | Mapping[str, Command] = None) -> Sample:
        """Commands the robot, and runs all control cycles until the next one of this robot.

        ``command``: also a mapping from robot names to commands.  A command holds until the next
        one.  Returns the sample of the robot.

        Raises ``DiagnosticError`` if the episode was not started, or if the simulation diverged.
        """
        self.command(command)
        if self.diverged:
            raise DiagnosticError(
                "simulation-diverged",
                f"the simulation diverged after {self.time:.2f} s; reset the episode",
            )
        self.advance(self._loop(self.name).next_time)
        return self.sample()

    def run(
        self,
        until: float,
        controller: Controller | Mapping[str, Controller] | None = None,
        on_tick: TickCallback | None = None,
    ) -> Sample:
        """Runs until the simulated time ``until`` (s), or until a robot falls over or the
        simulation diverges.

        ``controller``: function that returns the command of a robot after each of its samples, or a
        mapping from robot names to such functions.  ``on_tick``: function that is called with the
        control loop of a robot after each of its control cycles.  Returns the sample of the robot.
        """
        controllers = {} if controller is None else _by_robot(controller, self.name)

        def control(loop: ControlLoop) -> None:
            if loop.name in controllers:
                self._follow(loop, controllers[loop.name](loop.sample()))
            if on_tick is not None:
                on_tick(loop)

        for name, function in controllers.items():
            self._follow(self._loop(name), function(self.sample(name)))
        self.advance(until, control, ends_with_a_fall=True)
        return self.sample()

    def command(self, command: Command | Mapping[str, Command], robot: str = "") -> None:
        """Commands a robot, by default that of ``step``, from its next control cycle on."""
        for name, own in _by_robot(command, robot or self.name).items():
            self._follow(self._loop(name), own)

    def sample(self, robot: str = "") -> Sample:
        """Returns the measurements of a robot at its last control cycle."""
        return self._loop(robot or self.name).sample()

    def wheel_contacts(self, robot: str = "") -> tuple[WheelContact, ...]:
        """Returns the force (N) and the slip (m/s) of each wheel of a robot, in the wheel's frame.

        They are those of the last step of the physics, in the order of ``Robot.wheels``.  Raises
        ``DiagnosticError`` for ideal joints, which have no contacts.
        """
        if self.scene is None:
            raise DiagnosticError("simulation-scene", "ideal joints have no contacts")
        # Runs without forces do not import numpy for them.
        from thorvaldc.simulation.physics.wheel_contacts import wheel_contacts

        return wheel_contacts(self.robots[self._loop(robot or self.name).name], self.scene)

    @property
    def diverged(self) -> bool:
        """True if the simulation diverged."""
        return self.scene is not None and self.scene.diverged

    @property
    def ended(self) -> str:
        """Why the episode has ended, ``tipped`` or ``diverged``, or an empty text."""
        if self.diverged:
            return "diverged"
        return "tipped" if any(loop.tipped for loop in self._in_order) else ""

    # -- parts, for programs that step the scene themselves ----------------------------------------

    def begin(self, seed: int | None = None) -> None:
        """Starts an episode as ``reset``, without the first control cycle."""
        for name in self.starts:
            self.check_robot(name)
        self.close()
        if self.scene is not None:
            self.scene.reset()
        self.loops = {
            name: ControlLoop(
                name,
                robot,
                self._base(name, robot, seed),
                self._scripts.get(name, ()),
                self.parameters,
            )
            for name, robot in self.robots.items()
        }
        for name, start in self.starts.items():
            if start != self._own_starts[name]:
                self.loops[name].place(start)
        # The drivers of the robots may have different rates.  The heap contains the time of the
        # next tick of each robot.  Robots with equal tick times run in the order of the model, so
        # that episodes are repeatable.
        self._in_order = [*self.loops.values()]
        self._schedule = [(loop.next_time, number) for number, loop in enumerate(self._in_order)]
        if self.scene is not None:
            self.collisions = CollisionCounter(self.scene, self.robots)
        self.time = 0.0

    def advance(
        self,
        until: float,
        on_tick: TickCallback | None = None,
        *,
        ends_with_a_fall: bool = False,
    ) -> None:
        """Runs all control cycles until the time ``until`` (s), included.

        A divergence ends it, and with ``ends_with_a_fall`` also a robot that falls over.  Raises
        ``DiagnosticError`` if the time is not finite.
        """
        if not math.isfinite(until):
            raise DiagnosticError("twist-invalid", f"a run until {until:g} s never ends")
        while (loop := self.due(until)) is not None:
            self.tick(loop)
            if on_tick is not None:
                on_tick(loop)
            if ends_with_a_fall and loop.tipped:
                break

    def due(self, until: float) -> ControlLoop | None:
        """Returns the control loop that ticks next, or ``None`` if it does so after the time
        ``until`` (s) or if the simulation diverged.

        The scene is then ready to advance until this tick.
        """
        if not self._schedule or self.diverged:
            return None
        now, number = self._schedule[0]
        if now > until + _TOLERANCE:
            return None
        loop = self._in_order[number]
        if isinstance(loop.base, MujocoBase):
            loop.base.change_scene(now)
        return loop

    def tick(self, loop: ControlLoop) -> None:
        """Runs the scene until the tick of the loop that ``due`` has returned, and this tick."""
        self.time, number = self._schedule[0]
        loop.tick()
        heapq.heapreplace(self._schedule, (loop.next_time, number))
        if self.collisions is not None:
            self.collisions.update()
        if self._parameter_changes:
            self._change_parameters(loop)

    def close(self) -> None:
        """Restores the values of the MuJoCo model that faults and zones of a scenario changed."""
        while self._bases:
            self._bases.pop().close()

    def _loop(self, name: str) -> ControlLoop:
        self.check_robot(name)
        if not self.loops:
            raise DiagnosticError("simulation-scene", "the episode was not started; reset it first")
        return self.loops[name]

    def check_robot(self, name: str) -> None:
        """Raises ``ValueError`` if there is no robot with this name."""
        if name not in self.robots:
            known = ", ".join(self.robots) or "none"
            hint = did_you_mean(name, self.robots, f"the robots are {known}")
            raise ValueError(f"there is no robot `{name}`; {hint}")

    def _follow(self, loop: ControlLoop, command: Command) -> None:
        if isinstance(command, JointCommands):
            loop.follow_joints(command)
        elif command is None:
            loop.follow(self._scripts.get(loop.name, ()))
        else:
            loop.follow((Segment(-math.inf, twist_of(command)),))

    def _change_parameters(self, loop: ControlLoop) -> None:
        """Switches the driver to another parameter set at the times of the script.

        The driver applies a requested parameter change at the next tick.  The function requests a
        parameter change after the last tick before the time of the change, so that the change takes
        effect in time.  A parameter change at time 0 is requested after the first tick.
        """
        previous, following = loop.driver.state.time, loop.next_time
        if loop.manoeuvre is not self._scripts.get(loop.name):
            return
        for start, parameters in self._parameter_changes.get(loop.name, ()):
            if previous < start - _TOLERANCE <= following or start == previous == 0.0:
                loop.driver.use(parameters)

    def _base(self, name: str, robot: Robot, seed: int | None) -> BaseHandle:
        """Returns the base that the driver of a robot controls."""
        errors, scenario = self.wheel_errors.get(name), self.scenario
        if self.scene is None:
            if errors is None and not self.open_loop:
                return SimBase(robot)
            radii = Parameters.from_robot(robot, self.parameters).radii
            return RollingBase(robot, errors, radii)
        if scenario is None:
            return MujocoBase(robot, self.scene, wheel_errors=errors, open_loop=self.open_loop)
        noise = scenario.noise if seed is None else replace(scenario.noise, seed=seed)
        base = ScenarioBase(
            robot,
            self.scene,
            [fault for fault in scenario.faults if fault.robot == name],
            noise,
            self.world.zones if self.world is not None else (),
            open_loop=self.open_loop,
        )
        self._bases.append(base)
        return base


def _by_robot(value: T | Mapping[str, T], robot: str) -> Mapping[str, T]:
    """Returns commands or controllers by robot name; a single one is that of ``robot``."""
    return value if isinstance(value, Mapping) else {robot: value}


# -- commands --------------------------------------------------------------------------------------


def twist_of(values: Sequence[float]) -> Twist:
    """Returns three numbers (m/s, m/s, rad/s) as a twist.

    Raises ``DiagnosticError`` if they are not three finite numbers.
    """
    try:
        vx, vy, wz = map(float, values)
    except (TypeError, ValueError):
        raise DiagnosticError("twist-invalid", f"{values!r} is not a twist of 3 numbers") from None
    if not Twist(vx, vy, wz).finite:
        raise DiagnosticError("twist-invalid", f"the twist {(vx, vy, wz)} is not finite")
    return Twist(vx, vy, wz)


def manoeuvre_of(motion: Motion) -> Manoeuvre:
    """Returns a twist that lasts, or segments (start in s, twist), as a manoeuvre.

    Raises ``DiagnosticError`` if a start time or a twist is not finite, or if the segments are not
    in the order of their start times.
    """
    parts: Sequence[Any] = motion
    if len(parts) == 3 and not isinstance(parts[0], Sequence):
        return [Segment(0.0, twist_of(parts))]
    try:
        manoeuvre = [Segment(float(start), twist_of(twist)) for start, twist in parts]
    except (TypeError, ValueError):
        message = f"{motion!r} is neither a twist nor segments (start in s, twist)"
        raise DiagnosticError("twist-invalid", message) from None
    last = -math.inf
    for start, _ in manoeuvre:
        if not math.isfinite(start):
            raise DiagnosticError("twist-invalid", f"a twist from {start:g} s on; it never starts")
        if start < last:
            raise DiagnosticError(
                "twist-invalid",
                f"a twist from {start:g} s on follows one from {last:g} s on",
                hint="list the twists in the order of their times",
            )
        last = start
    return manoeuvre


# -- the files of a scene --------------------------------------------------------------------------


def _generated(model: Robot | Fleet) -> dict[str, bytes]:
    from thorvaldc.compiler.pipeline import emit_without_model

    return emit_without_model(model, ["mjcf"])


def _check_files(model: Robot | Fleet, files: Path | str | Mapping[str, bytes]) -> None:
    """Checks that the files of a scene are those of the model.

    A model may differ in what its scene does not contain, such as limits of the driver or the lines
    of the file; then its own scene has the same files.  Files without a model are not checked.

    Raises ``DiagnosticError``.
    """
    text = files.get(_MODEL_FILE) if isinstance(files, Mapping) else _read(Path(files, _MODEL_FILE))
    if text is None or text == to_json(model).encode():
        return
    for name, own in _generated(model).items():
        present = files.get(name) if isinstance(files, Mapping) else _read(Path(files, name))
        if present != own:
            raise DiagnosticError(
                "simulation-scene",
                f"the files of the scene are not those of {model.name}: {name} "
                + ("differs" if present is not None else "is missing"),
                model.span if isinstance(model, Robot) else None,
                hint="emit the files from this model, or build it again",
            )


def _read(file: Path) -> bytes | None:
    try:
        return file.read_bytes()
    except OSError:
        return None
