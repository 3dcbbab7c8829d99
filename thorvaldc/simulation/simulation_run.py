"""Simulates runs of a robot or a fleet, in MuJoCo or with ideal joints; reports problems."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.diagnostics import DiagnosticError, Report, millimetres
from thorvaldc.model import Fleet, Robot, Wheel, robots_by_name
from thorvaldc.model.model_json import load_model
from thorvaldc.model.statics.mobility import roll_speeds
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.runtime.se2 import Pose2, Twist, twist_text
from thorvaldc.runtime.twist_ramp import forbidding_part, is_axle_swing
from thorvaldc.simulation import control_loop
from thorvaldc.simulation.control_loop import ControlLoop, Manoeuvre, TickCallback
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import CollisionCounter, MujocoScene
from thorvaldc.simulation.physics.sim_base import GroundTruth, RollingBase, SimBase, WheelErrors
from thorvaldc.simulation.simulation_result import SimulationResult

if TYPE_CHECKING:
    from thorvaldc.model.scenario import SensorSettings
    from thorvaldc.simulation.records.recorder import Recorder
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
                f"the commanded twist of {loop.name} is {twist_text(loop.limited_twist)}; it is"
                f" limited to {twist_text(loop.limited_to)} by {loop.limit}",
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
        model: Robot | Fleet,
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
          joints.
        * ``parameters``: name of the parameter set of the drivers.
        * ``wheel_errors``: errors of the wheels by robot name.  The drivers do not correct the
          wheel errors.
        * ``open_loop``: true if the drive motors apply a voltage without speed control.
        * ``sensors``: settings of the sensors of the modules, which then measure in MuJoCo.
          ``None``: they measure, with the default settings, from the first use of ``sensors`` on.

        A simulation with ideal joints uses ``RollingBase``, in which no wheel slips, for robots
        with wheel errors or with ``open_loop``.

        Raises ``DiagnosticError`` if the scene cannot be read, if the scene belongs to another
        model, or if a robot does not have the parameter set ``parameters``.
        """
        self.robots = [*robots_by_name(model).items()]
        if isinstance(model, Fleet):
            self.starts = {
                p.name: Pose2(p.pose.xyz[0], p.pose.xyz[1], p.pose.rpy()[2])
                for p in model.placements
            }
        else:
            self.starts = {model.name: se2.ORIGIN}
        for _, robot in self.robots:
            Parameters.from_robot(robot, parameters)
        self.parameters = parameters
        world = model.world if isinstance(model, Fleet) else None
        self.rails = world is not None and any(block.kind == "rail" for block in world.blocks)
        self.scene = None if files is None else MujocoScene(files)
        self._files, self._sensor_settings = files, sensors
        self._suite: SensorSuite | None = None
        if sensors is not None:
            _ = self.sensors
        self.wheel_errors = wheel_errors or {}
        self.open_loop = open_loop

    def __repr__(self) -> str:
        names = [name for name, _ in self.robots]
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        return (
            f"<Simulation of {shown} {'with ideal joints' if self.scene is None else 'in MuJoCo'}>"
        )

    @property
    def sensors(self) -> SensorSuite:
        """The simulated sensors of the robots by name; in a fleet with the robot: ``r1/lidar``.

        ``sensors["lidar"].latest`` is the last message of a run, and the functions in
        ``sensors.listeners`` are called with each sensor and message.  The motion of a run is the
        same with and without sensors.

        Raises ``DiagnosticError`` for ideal joints, which have no scene to measure.
        """
        if self._suite is None:
            if self.scene is None or self._files is None:
                raise DiagnosticError(
                    "simulation-scene",
                    "sensors need a scene to measure, and ideal joints have none",
                    hint="leave out --ideal; in Python, give `Simulation` the files of the mjcf",
                )
            # Runs without sensors do not import numpy for them.
            from thorvaldc.model.scenario import SensorSettings
            from thorvaldc.simulation.sensors.sensor_suite import SensorSuite

            robots = [robot for _, robot in self.robots]
            settings = self._sensor_settings or SensorSettings()
            self._suite = SensorSuite(self.scene, self._files, robots, settings)
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

    def run(
        self,
        duration: float,
        motion: Twist | Manoeuvre | Mapping[str, Manoeuvre],
        report: Report | None = None,
        on_tick: TickCallback | None = None,
    ) -> SimulationResult:
        """Simulates a run of ``duration`` s from rest and returns the result of the run.

        ``motion`` is one twist, a manoeuvre for all robots, or a mapping from robot names to
        manoeuvres.  The run ends early if a robot falls over or the simulation diverges.  A fall,
        a divergence and a commanded twist that a robot cannot drive are added to ``report``.

        After each tick of a robot, ``on_tick`` is called with the control loop of the robot.
        ``ControlLoop.sample`` then returns the measurements of the tick.

        Raises ``DiagnosticError`` if the run cannot start.
        """
        if not 0.0 < duration < math.inf:
            raise DiagnosticError("twist-invalid", f"a run of {duration:g} s; it must be positive")
        if self.scene is not None:
            self.scene.reset()
        loops = [
            ControlLoop(
                name, robot, self._base(name, robot), _manoeuvre(motion, name), self.parameters
            )
            for name, robot in self.robots
        ]
        # The drivers of the robots may have different rates.  The heap contains the time of the
        # next tick of each robot.  Robots with equal tick times run in the order of the model, so
        # that runs are repeatable.
        schedule = [(loop.next_time, number) for number, loop in enumerate(loops)]
        collisions = None
        if self.scene is not None:
            collisions = CollisionCounter(self.scene, dict(self.robots))
        started = time.perf_counter()
        simulated = 0.0
        stopped = False
        while schedule and not stopped:
            now, number = schedule[0]
            if now > duration + 1e-9:
                break
            simulated = now
            loop = loops[number]
            loop.tick()
            heapq.heapreplace(schedule, (loop.next_time, number))
            if collisions is not None:
                collisions.update()
            if on_tick is not None:
                on_tick(loop)
            stopped = loop.tipped or (self.scene is not None and self.scene.diverged)
        wall = time.perf_counter() - started
        diverged = self.scene is not None and self.scene.diverged
        result = SimulationResult(
            "ideal" if self.scene is None else "mujoco",
            duration,
            simulated,
            simulated / wall if wall > 0.0 else 0.0,
            diverged,
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
            fastest = self.scene.fastest if diverged and self.scene is not None else ""
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
            name, robot = self.robots[0]
            manoeuvre, end = control_loop.default_manoeuvre(robot)
            return {name: manoeuvre}, end
        return control_loop.fleet_manoeuvres(
            [(name, robot, self.starts[name]) for name, robot in self.robots]
        )

    def _report_radii(self, report: Report) -> None:
        """Reports a parameter set whose wheel radii differ from the wheel radii of the scene.

        The wheel radii of the scene are fixed when the scene is built.  A parameter set changes
        only the wheel radii that the driver assumes.
        """
        for name, robot in self.robots:
            if self.rails and any(wheel.treads for wheel in robot.wheels):
                continue  # the radius changes along the path: on the tyre, or on a rail
            radii = Parameters.from_robot(robot, self.parameters).radii
            for wheel, radius in zip(robot.wheels, radii, strict=True):
                if wheel.driven and radius != wheel.radius:
                    report.add(
                        "parameter-set-scene",
                        f"the parameter set `{self.parameters}` of {name} has a radius of "
                        f"{millimetres(radius, 6)} for {wheel.name}; in this scene it rolls on "
                        f"{millimetres(wheel.radius, 6)}",
                        robot.span,
                        hint="use ideal joints (--ideal), or a parameter set with these radii",
                    )
                    break

    def _base(self, name: str, robot: Robot) -> BaseHandle:
        """Returns the base that the driver of a robot controls."""
        wheel_errors = self.wheel_errors.get(name)
        if self.scene is not None:
            return MujocoBase(
                robot, self.scene, wheel_errors=wheel_errors, open_loop=self.open_loop
            )
        if wheel_errors is not None or self.open_loop:
            return RollingBase(
                robot, wheel_errors, Parameters.from_robot(robot, self.parameters).radii
            )
        return SimBase(robot)


def _manoeuvre(motion: Twist | Manoeuvre | Mapping[str, Manoeuvre], robot: str) -> Manoeuvre:
    """Returns the manoeuvre of a robot.

    Raises ``DiagnosticError`` if a start time or a twist is not finite.
    """
    manoeuvre: Manoeuvre
    if isinstance(motion, Twist):
        manoeuvre = (control_loop.Segment(0.0, motion),)
    elif isinstance(motion, Mapping):
        manoeuvre = motion.get(robot, ())
    else:
        manoeuvre = motion
    for start, twist in manoeuvre:
        if not (math.isfinite(start) and twist.finite):
            raise DiagnosticError(
                "twist-invalid", f"the twist {tuple(twist)} from {start:g} s on is not finite"
            )
    return manoeuvre


def drive_build(build: Path, report: Report) -> SimulationResult | None:
    """Simulates the default manoeuvre of the robots of a build folder in MuJoCo.

    The function reads only the generated ``model.json``, ``mjcf/`` and ``meshes/``.  If the run
    cannot start, the function adds the reason to ``report`` and returns ``None``.
    """
    try:
        return Simulation(load_model(build), build).demonstrate(report)
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return None
