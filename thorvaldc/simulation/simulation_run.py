"""Drives robots in simulation and says how it went."""

from __future__ import annotations

import dataclasses
import heapq
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_file import load_model
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle, JointStates
from thorvaldc.runtime.driver_parameters import Parameters
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.drive_metrics import NOTICEABLE, Meter, RobotRun, Watch, size
from thorvaldc.simulation.manoeuvre import Manoeuvre, Segment, default_manoeuvre, fleet_manoeuvres
from thorvaldc.simulation.physics.hidden_errors import HiddenErrors
from thorvaldc.simulation.physics.mujoco_base import MujocoBase, MujocoScene
from thorvaldc.simulation.physics.rolling_base import RollingBase
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.physics.simulated_base import SimulatedBase
from thorvaldc.simulation.vectorised.robot_groups import RobotGroups


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """A run: what was asked for and simulated, in s, and each robot's part.

    ``physics`` is ``mujoco``, ``ideal`` or of one played back ``record``;
    ``real_time_factor`` simulated time over the time it took.
    """

    physics: str
    duration: float
    simulated: float
    real_time_factor: float
    diverged: bool
    robots: tuple[RobotRun, ...]

    def as_json(self) -> dict[str, Any]:
        """The result as plain values; twists and poses as named mappings."""
        value = dataclasses.asdict(self)
        for run, robot in zip(value["robots"], self.robots, strict=True):
            for key in ("pose_true", "pose_odometry", "infeasible"):
                run[key] = getattr(robot, key)._asdict()
            run["unreachable"] = list(robot.unreachable)
        value["robots"] = list(value["robots"])
        return value


class Simulation:
    """A robot, or a fleet in one scene, ready to drive.

    With ``files`` (a build folder, or the outputs of the ``mjcf`` backend as
    ``{path: bytes}``) it drives in MuJoCo, without on ideal joints.  ``hidden`` are
    errors that robots have, by their names, and their drivers do not know of;
    with ``open_loop`` the drives do not control their speed.  On ideal
    joints either lets no wheel slip (``RollingBase``).
    """

    def __init__(
        self,
        model: Robot | Fleet,
        files: Path | str | Mapping[str, bytes] | None = None,
        parameters: str | None = None,
        *,
        hidden: Mapping[str, HiddenErrors] | None = None,
        open_loop: bool = False,
    ) -> None:
        """``parameters`` names the parameter set that the robots drive by.

        Raises ``DiagnosticError`` where the scene cannot be read or is not of this model,
        and where a robot has no such set.
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
        self.hidden = hidden or {}
        self.open_loop = open_loop

    def run(
        self,
        duration: float,
        motion: Twist | Manoeuvre | Mapping[str, Manoeuvre],
        report: Report | None = None,
        watch: Watch | None = None,
    ) -> SimulationResult:
        """Drive for ``duration`` s from rest and measure.

        ``motion`` is one twist, a manoeuvre for all, or one by robot.  What goes
        wrong on the way (a robot falls over, the simulation diverges, a twist
        cannot be driven) goes to ``report`` and the run ends there.  ``watch`` is
        called with the robot's meter after each of its ticks (``Meter.sample``).
        Raises ``DiagnosticError`` where it cannot start.
        """
        if not 0.0 < duration < math.inf:
            raise DiagnosticError("twist-invalid", f"a run of {duration:g} s; it must be positive")
        if self.scene is not None:
            self.scene.reset()
        meters = [
            Meter(name, robot, self._base(name, robot), _manoeuvre(motion, name), self.parameters)
            for name, robot in self.robots
        ]
        # When whose next tick is due: a heap, in the order of robots where times are equal.
        due = [(meter.next, number) for number, meter in enumerate(meters)]
        groups = RobotGroups([meter.driver for meter in meters])
        joints: dict[int, JointStates] = {}
        started = time.perf_counter()
        simulated = 0.0
        stopped = False
        while due and not stopped:
            now, number = due[0]
            if now > duration + 1e-9:
                break
            if groups.groups and now > simulated:
                joints = groups.update_odometry(now, [k for at, k in due if at == now])
            simulated = now
            meter = meters[number]
            meter.tick(joints.get(number))
            heapq.heapreplace(due, (meter.next, number))
            if watch is not None:
                watch(meter)
            stopped = meter.tipped or (self.scene is not None and self.scene.diverged)
        wall = time.perf_counter() - started
        diverged = self.scene is not None and self.scene.diverged
        result = SimulationResult(
            "ideal" if self.scene is None else "mujoco",
            duration,
            simulated,
            simulated / wall if wall > 0.0 else 0.0,
            diverged,
            tuple(meter.result() for meter in meters),
        )
        if report is not None:
            if self.scene is not None:
                self._tell_radii(report)
            cause = f": {self.scene.fastest}" if diverged and self.scene is not None else ""
            _tell(meters, result, report, cause)
        return result

    def demonstrate(
        self,
        report: Report | None = None,
        duration: float | None = None,
        watch: Watch | None = None,
    ) -> SimulationResult:
        """Drive the default manoeuvre, for ``duration`` s or to its end."""
        plans, end = self.demonstration()
        return self.run(duration or end, plans, report, watch)

    def demonstration(self) -> tuple[Mapping[str, Manoeuvre], float]:
        """The default manoeuvres by robot, and their length in s."""
        if len(self.robots) == 1:
            name, robot = self.robots[0]
            plan, end = default_manoeuvre(robot)
            return {name: plan}, end
        return fleet_manoeuvres([(name, robot, self.starts[name]) for name, robot in self.robots])

    def _tell_radii(self, report: Report) -> None:
        """Without rails a scene's wheels roll on their ordinary radii, whatever set is in force."""
        for name, robot in self.robots:
            if self.rails and any(wheel.treads for wheel in robot.wheels):
                continue  # where it rolls on what, only its way tells
            radii = Parameters.from_robot(robot, self.parameters).radii
            for wheel, radius in zip(robot.wheels, radii, strict=True):
                if wheel.driven and radius != wheel.radius:
                    report.add(
                        "parameter-set-scene",
                        f"{name} drives by `{self.parameters}`, with {wheel.name} on "
                        f"{radius * 1000:.6g} mm; in this scene it rolls on "
                        f"{wheel.radius * 1000:.6g} mm",
                        robot.span,
                        hint="drive with ideal joints (--ideal), or by a set of these radii",
                    )
                    break

    def _base(self, name: str, robot: Robot) -> BaseHandle:
        hidden = self.hidden.get(name)
        if self.scene is not None:
            return MujocoBase(robot, self.scene, hidden=hidden, open_loop=self.open_loop)
        if hidden is not None or self.open_loop:
            return RollingBase(robot, hidden, Parameters.from_robot(robot, self.parameters).radii)
        return SimBase(robot)


def _manoeuvre(motion: Twist | Manoeuvre | Mapping[str, Manoeuvre], name: str) -> Manoeuvre:
    if isinstance(motion, Twist):
        found: Manoeuvre = (Segment(0.0, motion),)
    elif isinstance(motion, Mapping):
        found = motion.get(name, ())
    else:
        found = motion
    for start, twist in found:
        if not (math.isfinite(start) and twist.finite):
            raise DiagnosticError(
                "twist-invalid", f"the twist {tuple(twist)} from {start:g} s on is not finite"
            )
    return found


_AT_ONCE = 0.5  # s; who falls over sooner was thrown by what it stood in, not by its driving
_LOWER = "lower its speed or accelerations, or its centre of mass, or widen its track"
_ELSEWHERE = "see that it does not start within an obstacle or another robot"


def _words(twist: Twist) -> str:
    return f"({twist.vx:.3g} m/s, {twist.vy:.3g} m/s, {twist.wz:.3g} rad/s)"


def _way(meter: Meter) -> str:
    way = meter.base.leaning() if isinstance(meter.base, SimulatedBase) else ""
    return f" {way}" if way else ""


def _tell(
    meters: Sequence[Meter], result: SimulationResult, report: Report, cause: str = ""
) -> None:
    if result.diverged:
        report.add(
            "simulation-diverged",
            f"the simulation left all bounds after {result.simulated:.2f} s{cause}",
            next((m for m in meters if f"`{m.robot.namespace}/" in cause), meters[0]).robot.span,
            hint="look for masses or inertias that are very small beside the forces on them",
        )
        return
    for meter in meters:
        if meter.tipped:
            report.add(
                "simulation-tipped",
                f"{meter.name} fell over{_way(meter)} after {result.simulated:.2f} s, "
                f"asked for {_words(meter.driver.state.commanded_twist)}",
                meter.robot.span,
                hint=_LOWER if result.simulated >= _AT_ONCE else _ELSEWHERE,
            )
        if meter.unreachable:
            wheels = ", ".join(meter.robot.wheels[i].name for i in meter.unreachable)
            report.add(
                "steering-unreachable",
                f"{meter.name} cannot steer {wheels} to the motion "
                f"{_words(meter.unreachable_twist)} within the joints' limits",
                meter.robot.span,
                hint="ask for another motion, or widen the steering limits",
            )
        if size(meter.infeasible) > NOTICEABLE and not _only_swing(meter):
            report.add(
                "twist-infeasible",
                f"{meter.name} was asked for {_words(meter.infeasible_twist)}; "
                f"its fixed wheels do not allow {_words(meter.infeasible)} of it",
                meter.robot.span,
                hint="a robot with fixed wheels cannot move across them",
            )


def _only_swing(meter: Meter) -> bool:
    """Whether all that was infeasible is the swing of base_link beside the fixed axle.

    Who asks for a turn without saying where an axle lies asks for nothing impossible.
    """
    asked, left = meter.infeasible_twist, meter.infeasible
    across = asked.vx * left.vx + asked.vy * left.vy
    return abs(across) < 1e-6 and abs(left.wz) < 1e-6


# -- the demonstration ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DemoRow:
    """A robot's line in the demonstration's table."""

    run: RobotRun
    real_time_factor: float


def run_demo(build: Path, report: Report) -> list[DemoRow]:
    """Drive what lies in a build folder through its default manoeuvre, in MuJoCo.

    Reads only the generated ``model.json``, ``mjcf/`` and ``meshes/``.  One row
    per robot; none where the report has the reason.
    """
    try:
        result = Simulation(load_model(build), build).demonstrate(report)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
        return []
    return [DemoRow(run, result.real_time_factor) for run in result.robots]


def demo_table(rows: Sequence[DemoRow]) -> str:
    """The rows as aligned text with a heading; lengths in m, mass in kg; `-` for nan."""
    head = (
        "robot",
        "mass",
        "wheels driven/steered",
        "commanded",
        "true",
        "odometry",
        "end error",
        "real time",
    )
    lines = [head]
    for row in rows:
        run = row.run
        lines.append(
            (
                run.name,
                f"{run.mass:.1f} kg",
                f"{run.wheels}: {run.driven}/{run.steered}",
                _cell(f"{run.path_commanded:.3f} m"),
                _cell(f"{run.path_true:.3f} m"),
                _cell(f"{run.path_odometry:.3f} m"),
                _cell(f"{run.end_error * 1000:.1f} mm"),
                _cell(f"{row.real_time_factor:.0f}x"),
            )
        )
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _cell(text: str) -> str:
    return "-" if text.startswith("nan") else text
