"""Simulates runs of a robot or a fleet, in MuJoCo or with ideal joints; reports problems."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.diagnostics import DiagnosticError, Report, millimetres
from thorvaldc.model import Fleet, Robot, Wheel
from thorvaldc.model.scenario import Scenario
from thorvaldc.model.statics.mobility import roll_speeds
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.runtime.se2 import Pose2, Twist, twist_text
from thorvaldc.runtime.twist_ramp import forbidding_part, is_axle_swing
from thorvaldc.simulation import control_loop
from thorvaldc.simulation.control_loop import ControlLoop, Manoeuvre, TickCallback
from thorvaldc.simulation.episode import Episode, Motion, manoeuvre_of
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.physics.sim_base import GroundTruth, WheelErrors
from thorvaldc.simulation.simulation_result import SimulationResult

if TYPE_CHECKING:
    from thorvaldc.model.scenario import SensorSettings
    from thorvaldc.simulation.sensors.sensor_suite import SensorSuite


# -- diagnostics of a run --------------------------------------------------------------------------

_START_DURATION = 0.5
"""Time (s) before which the cause of a fall is the start position and not the motion."""


def report_run(
    loops: Sequence[ControlLoop],
    result: SimulationResult,
    report: Report,
    fastest_joint: str = "",
) -> None:
    """Adds the problems of a finished run to ``report``.

    ``fastest_joint`` is a description of the fastest joint, for a simulation that diverged.
    """
    if result.diverged:
        cause = f": {fastest_joint}" if fastest_joint else ""
        report.add(
            "simulation-diverged",
            f"the simulation diverged after {result.simulated:.2f} s{cause}",
            next((m for m in loops if f"`{m.robot.namespace}/" in cause), loops[0]).robot.span,
            hint="look for masses or inertias that are very small compared with the forces on them",
        )
        return
    for loop, robot_result in zip(loops, result.robots, strict=True):
        if robot_result.collisions:
            count = robot_result.collisions
            report.add(
                "simulation-collision",
                f"{loop.name} had {count} collision{'s' if count > 1 else ''} with other robots,"
                " the world or its own parts",
                loop.robot.span,
                hint="start the robots farther apart, or give them other motions",
            )
        if loop.tipped:
            in_motion = result.simulated >= _START_DURATION
            report.add(
                "simulation-tipped",
                f"{loop.name} fell over{_direction(loop)} after {result.simulated:.2f} s; "
                f"the commanded twist was {twist_text(loop.driver.state.commanded_twist)}",
                loop.robot.span,
                hint="lower its speed, accelerations or centre of mass, or widen its track"
                if in_motion
                else "check that it does not start inside an obstacle or another robot",
            )
        if loop.unreachable:
            wheels = ", ".join(loop.robot.wheels[i].name for i in loop.unreachable)
            reachable = loop.driver.calculator.feasible(loop.unreachable_twist)
            stands = control_loop.largest_component(reachable) <= control_loop.NEGLIGIBLE_TWIST
            motion = "stands" if stands else f"moves with {twist_text(reachable)} instead"
            report.add(
                "steering-unreachable",
                f"{loop.name} cannot steer {wheels} for the twist "
                f"{twist_text(loop.unreachable_twist)} within the joint limits; "
                f"it {motion}",
                loop.robot.span,
                hint="command another twist, or widen the steering limits",
            )
        if loop.limit:
            report.add(
                "twist-limited",
                f"the commanded twist of {loop.name} is {twist_text(loop.limited_twist, 4)}; it is"
                f" limited to {twist_text(loop.limited_to, 4)} by {loop.limit}",
                loop.robot.span,
                hint="command a slower twist, or change the limit in `driver` of the robot file",
            )
        if loop.not_followed:
            report.add(
                "twist-not-followed",
                f"{loop.name} does not follow its command: {loop.not_followed}",
                loop.robot.span,
                hint="command a slower twist, or free the steering joint that the message names",
            )
        limited = loop.driver.calculator.limiting_wheels(loop.infeasible_twist)
        if (
            control_loop.largest_component(loop.infeasible) > control_loop.NEGLIGIBLE_TWIST
            and not limited
            and not is_axle_swing(loop.infeasible_twist, loop.infeasible)
        ):
            turned = _turned_wheel(loop.robot, loop.infeasible_twist)
            report.add(
                "twist-infeasible",
                f"the commanded twist of {loop.name} is {twist_text(loop.infeasible_twist)}; "
                f"its {forbidding_part(loop.robot)} not allow the part"
                f" {twist_text(loop.infeasible)}",
                loop.robot.span if turned is None else turned.span,
                hint="command a twist without this part; no robot moves across its fixed wheels"
                if turned is None
                else f"other fixed wheels allow it; turn the mount of `{turned.module}`",
            )


def _turned_wheel(robot: Robot, twist: Twist) -> Wheel | None:
    """Returns the first fixed wheel that blocks a straight motion which other ones allow."""
    if twist.wz:
        return None
    fixed = [w for w in robot.wheels if w.steering_joint is None and w.swivel_joint is None]
    blocking = [w for w in fixed if roll_speeds(replace(robot, wheels=(w,)), twist) is None]
    return blocking[0] if 0 < len(blocking) < len(fixed) else None


def _direction(loop: ControlLoop) -> str:
    direction = loop.base.leaning() if isinstance(loop.base, GroundTruth) else ""
    return f" {direction}" if direction else ""


class Simulation:
    """A simulation of a robot, or of a fleet in one scene, for any number of runs.

    >>> import thorvaldc
    >>> robot = thorvaldc.load("examples/4wd4ws_wide/robot.yaml")
    >>> simulation = thorvaldc.Simulation(robot)  # ideal joints; with files: in MuJoCo
    >>> result = simulation.run(2.0, thorvaldc.Twist(0.5, 0.0, 0.0))
    >>> round(result.robots[0].path_true, 1)  # m
    0.9
    """

    def __init__(
        self,
        model: Robot | Fleet | Scenario | Path | str,
        files: Path | str | Mapping[str, bytes] | None = None,
        parameters: str | None = None,
        *,
        wheel_errors: Mapping[str, WheelErrors] | None = None,
        open_loop: bool = False,
        sensors: SensorSettings | None = None,
    ) -> None:
        """Loads the scene of the robots.

        * ``files``: a build folder, or the outputs of the ``mjcf`` backend as ``{path: bytes}``.
          With ``files`` the robots drive in MuJoCo.  Without ``files`` the robots have ideal
          joints, unless ``model`` is the path of a build folder.

        The other parameters and the errors are those of ``Episode``.
        """
        self.episode = Episode(
            model,
            files,
            parameters,
            ideal=files is None and not isinstance(model, (Path, str)),
            wheel_errors=wheel_errors,
            open_loop=open_loop,
            sensors=sensors,
        )

    def __repr__(self) -> str:
        return repr(self.episode).replace("Episode", type(self).__name__)

    @property
    def robots(self) -> Mapping[str, Robot]:
        """The robots by name."""
        return self.episode.robots

    @property
    def scene(self) -> MujocoScene | None:
        """The MuJoCo scene, or ``None`` with ideal joints."""
        return self.episode.scene

    @property
    def starts(self) -> dict[str, Pose2]:
        """Start pose (m, rad) of each robot in the world, for the next runs."""
        return self.episode.starts

    @starts.setter
    def starts(self, starts: Mapping[str, Pose2]) -> None:
        self.episode.starts = dict(starts)

    @property
    def sensors(self) -> SensorSuite:
        """The simulated sensors, see ``Episode.sensors``."""
        return self.episode.sensors

    def run(
        self,
        duration: float,
        motion: Motion | Mapping[str, Motion],
        report: Report | None = None,
        on_tick: TickCallback | None = None,
    ) -> SimulationResult:
        """Simulates a run of ``duration`` s from rest and returns the result of the run.

        ``motion`` is one twist, a manoeuvre for all robots, or a mapping from robot names to twists
        or manoeuvres.  The run ends early if a robot falls over or the simulation diverges.  A
        fall, a divergence and a commanded twist that a robot cannot drive are added to ``report``.

        After each tick of a robot, ``on_tick`` is called with the control loop of the robot.
        ``ControlLoop.sample`` then returns the measurements of the tick.

        Raises ``DiagnosticError`` if the run cannot start, and ``ValueError`` if there is no robot
        with a name of the mapping.
        """
        if not 0.0 < duration < math.inf:
            raise DiagnosticError("twist-invalid", f"a run of {duration:g} s; it must be positive")
        episode = self.episode
        by_robot = motion if isinstance(motion, Mapping) else dict.fromkeys(self.robots, motion)
        manoeuvres = {name: manoeuvre_of(own) for name, own in by_robot.items()}
        episode.begin()
        for name, manoeuvre in manoeuvres.items():
            episode.check_robot(name)
            episode.loops[name].follow(manoeuvre)
        return self._finish(duration, report, on_tick)

    def _finish(
        self, duration: float, report: Report | None, on_tick: TickCallback | None
    ) -> SimulationResult:
        """Runs a started episode, and returns its result."""
        episode = self.episode
        started = time.perf_counter()
        try:
            episode.advance(duration, on_tick, ends_with_a_fall=True)
        finally:
            episode.close()
        wall = time.perf_counter() - started
        loops, collisions = [*episode.loops.values()], episode.collisions
        result = SimulationResult(
            "ideal" if self.scene is None else "mujoco",
            duration,
            episode.time,
            episode.time / wall if wall > 0.0 else 0.0,
            episode.diverged,
            tuple(
                replace(loop.result(), collisions=collisions.collisions[loop.name])
                if collisions is not None
                else loop.result()
                for loop in loops
            ),
        )
        if report is not None:
            if self.scene is not None:
                self._report_radii(report)
            fastest = self.scene.fastest if episode.diverged and self.scene is not None else ""
            report_run(loops, result, report, fastest)
        return result

    def demonstrate(
        self,
        report: Report | None = None,
        duration: float | None = None,
        on_tick: TickCallback | None = None,
    ) -> SimulationResult:
        """Simulates the default manoeuvre and returns the result of the run.

        The run lasts ``duration`` s, or until the end of the manoeuvre if ``duration`` is
        ``None``.
        """
        manoeuvres, end = self.demonstration()
        return self.run(duration or end, manoeuvres, report, on_tick)

    def demonstration(self) -> tuple[Mapping[str, Manoeuvre], float]:
        """Returns the default manoeuvres by robot name, and the duration of the manoeuvres (s)."""
        if len(self.robots) == 1:
            ((name, robot),) = self.robots.items()
            manoeuvre, end = control_loop.default_manoeuvre(robot)
            return {name: manoeuvre}, end
        return control_loop.fleet_manoeuvres(
            [(name, robot, self.starts[name]) for name, robot in self.robots.items()]
        )

    def _report_radii(self, report: Report) -> None:
        """Reports a parameter set whose wheel radii differ from the wheel radii of the scene.

        The wheel radii of the scene are fixed when the scene is built.  A parameter set changes
        only the wheel radii that the driver assumes.
        """
        world, parameters = self.episode.world, self.episode.parameters
        on_rails = world is not None and any(block.kind == "rail" for block in world.blocks)
        for name, robot in self.robots.items():
            if on_rails and any(wheel.treads for wheel in robot.wheels):
                continue  # the radius changes along the path: on the tyre, or on a rail
            radii = Parameters.from_robot(robot, parameters).radii
            for wheel, radius in zip(robot.wheels, radii, strict=True):
                if wheel.driven and radius != wheel.radius:
                    report.add(
                        "parameter-set-scene",
                        f"the parameter set `{parameters}` of {name} has a radius of "
                        f"{millimetres(radius, 6)} for {wheel.name}; in this scene it rolls on "
                        f"{millimetres(wheel.radius, 6)}",
                        robot.span,
                        hint="use ideal joints (--ideal), or a parameter set with these radii",
                    )
                    break


def drive_build(build: Path, report: Report) -> SimulationResult | None:
    """Simulates the default manoeuvre of the robots of a build folder in MuJoCo.

    The function reads only the generated ``model.json``, ``mjcf/`` and ``meshes/``.  If the run
    cannot start, the function adds the reason to ``report`` and returns ``None``.
    """
    try:
        return Simulation(build).demonstrate(report)
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return None
