"""Simulates runs of a robot or a fleet, in MuJoCo or with ideal joints."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.plain_numbers import millimetres
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import load_model
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle, JointStates
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import ControlLoop, TickCallback
from thorvaldc.simulation.manoeuvre import Manoeuvre, Segment, default_manoeuvre, fleet_manoeuvres
from thorvaldc.simulation.physics.collision_counter import CollisionCounter
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.physics.rolling_base import RollingBase
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.physics.wheel_errors import WheelErrors
from thorvaldc.simulation.run_diagnostics import report_run
from thorvaldc.simulation.run_result import SimulationResult
from thorvaldc.simulation.vectorised.robot_groups import MIN_GROUP_SIZE, RobotGroups


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
    ) -> None:
        """Loads the scene of the robots.

        * ``files``: a build folder, or the outputs of the ``mjcf`` backend as ``{path: bytes}``.
          With ``files`` the robots drive in MuJoCo.  Without ``files`` the robots have ideal
          joints.
        * ``parameters``: name of the parameter set of the drivers.
        * ``wheel_errors``: errors of the wheels by robot name.  The drivers do not correct the
          wheel errors.
        * ``open_loop``: true if the drive motors apply a voltage without speed control.

        A simulation with ideal joints uses ``RollingBase``, in which no wheel slips, for robots
        with wheel errors or with ``open_loop``.

        Raises ``DiagnosticError`` if the scene cannot be read, if the scene belongs to another
        model, or if a robot does not have the parameter set ``parameters``.
        """
        if isinstance(model, Fleet):
            self.robots = [(p.name, p.robot) for p in model.placements]
            self.starts = {
                p.name: Pose2(p.pose.xyz[0], p.pose.xyz[1], p.pose.rpy()[2])
                for p in model.placements
            }
        else:
            self.robots = [(model.name, model)]
            self.starts = {model.name: se2.ORIGIN}
        for _, robot in self.robots:
            Parameters.from_robot(robot, parameters)
        self.parameters = parameters
        world = model.world if isinstance(model, Fleet) else None
        self.rails = world is not None and any(block.kind == "rail" for block in world.blocks)
        self.scene = None if files is None else MujocoScene(files)
        self.wheel_errors = wheel_errors or {}
        self.open_loop = open_loop

    def __repr__(self) -> str:
        names = [name for name, _ in self.robots]
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        return (
            f"<Simulation of {shown} {'with ideal joints' if self.scene is None else 'in MuJoCo'}>"
        )

    def run(
        self,
        duration: float,
        motion: Twist | Manoeuvre | Mapping[str, Manoeuvre],
        report: Report | None = None,
        on_tick: TickCallback | None = None,
        *,
        sampled: bool = True,
    ) -> SimulationResult:
        """Simulates a run of ``duration`` s from rest and returns the result of the run.

        ``motion`` is one twist, a manoeuvre for all robots, or a mapping from robot names to
        manoeuvres.  The run ends early if a robot falls over or the simulation diverges.  A fall,
        a divergence and a commanded twist that a robot cannot drive are added to ``report``.

        After each tick of a robot, ``on_tick`` is called with the control loop of the robot.
        ``ControlLoop.sample`` then returns the measurements of the tick.  If ``on_tick`` reads
        neither samples nor the odometry of the driver, ``sampled`` may be false: the result is the
        same, and the run takes less time.

        Raises ``DiagnosticError`` if the run cannot start.
        """
        if not 0.0 < duration < math.inf:
            raise DiagnosticError("twist-invalid", f"a run of {duration:g} s; it must be positive")
        if self.scene is not None:
            self.scene.reset()
        # The odometry of a large group of robots is computed as a batch in each tick.
        sampled = (sampled and on_tick is not None) or len(self.robots) >= MIN_GROUP_SIZE
        loops = [
            ControlLoop(
                name,
                robot,
                self._base(name, robot),
                _manoeuvre(motion, name),
                self.parameters,
                sampled=sampled,
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
        groups = RobotGroups([loop.driver for loop in loops])
        joints: dict[int, JointStates] = {}
        started = time.perf_counter()
        simulated = 0.0
        stopped = False
        while schedule and not stopped:
            now, number = schedule[0]
            if now > duration + 1e-9:
                break
            if groups.groups and now > simulated:
                joints = groups.update_odometry(now, [i for start, i in schedule if start == now])
            simulated = now
            loop = loops[number]
            loop.tick(joints.get(number))
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
            manoeuvre, end = default_manoeuvre(robot)
            return {name: manoeuvre}, end
        return fleet_manoeuvres([(name, robot, self.starts[name]) for name, robot in self.robots])

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
        manoeuvre = (Segment(0.0, motion),)
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
