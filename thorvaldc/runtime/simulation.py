"""Drives robots in simulation and says how it went."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.serialize import ModelFormatError, from_json
from thorvaldc.runtime import se2
from thorvaldc.runtime.base import BaseHandle
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.faults import RuntimeFault
from thorvaldc.runtime.manoeuvre import Manoeuvre, Segment, default_manoeuvre, twist_at
from thorvaldc.runtime.mujoco_base import MujocoBase, MujocoScene
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2, Twist
from thorvaldc.runtime.sim_base import SimBase

_TIPPED = math.cos(math.radians(60.0))
_NOTICEABLE = 0.01
"""Infeasible or unreachable motion (m/s, rad/s) below which nobody is told."""


@dataclass(frozen=True, slots=True)
class RobotRun:
    """How one robot drove.  Lengths in m, angles in rad, poses relative to the start.

    ``path_commanded`` is the way of ``base_link`` that the driver aimed at, its
    ramps and limits applied; ``path_true`` the way in the simulated world and
    ``path_odometry`` that by the joints.  ``end_error`` is the distance between
    the true and the estimated position at the end, ``yaw_error`` that of the headings.
    With ideal joints there is no other truth than the joints: true is odometry.
    """

    name: str
    mass: float
    wheels: int
    driven: int
    steered: int
    path_commanded: float
    path_true: float
    path_odometry: float
    end_error: float
    yaw_error: float
    pose_true: Pose2
    pose_odometry: Pose2
    largest_tilt: float
    infeasible: Twist
    unreachable: tuple[str, ...]
    tipped: bool


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """A run: what was asked for and simulated, in s, and each robot's part.

    ``physics`` is ``mujoco`` or ``ideal``; ``real_time_factor`` simulated time
    over the time it took.
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


class _Meter:
    """One robot of a run: its driver, and what is measured beside it."""

    def __init__(self, name: str, robot: Robot, base: BaseHandle, manoeuvre: Manoeuvre) -> None:
        self.name = name
        self.robot = robot
        self.driver = BaseDriver(robot, base)
        self.base = base
        self.manoeuvre = manoeuvre
        self.ticks = 0
        self.start = base.true_pose() if isinstance(base, MujocoBase) else se2.ORIGIN
        self.true = self.start
        self.turned = 0.0
        self.commanded = self.path = self.estimated = 0.0
        self.largest_tilt = 0.0
        self.infeasible = ZERO_TWIST
        self.unreachable: tuple[int, ...] = ()
        self.unreachable_twist = ZERO_TWIST
        self.infeasible_twist = ZERO_TWIST

    @property
    def next(self) -> float:
        return self.ticks / self.robot.driver.rate

    def tick(self) -> None:
        now = self.next
        before = self.driver.state
        self.driver.command(twist_at(self.manoeuvre, now), now)
        state = self.driver.tick(now)
        if self.ticks:
            dt = now - before.time
            if before.command is not None:
                self.commanded += before.command.target.speed * dt
            self.estimated += state.odometry.twist.speed * dt
            self._measure_truth()
        self.ticks += 1
        command = state.command
        if command is None:
            return
        if _size(command.infeasible) > _size(self.infeasible):
            self.infeasible, self.infeasible_twist = command.infeasible, state.ramped
        for i in command.unreachable:
            if i not in self.unreachable and _size(state.ramped) > _NOTICEABLE:
                self.unreachable += (i,)
                self.unreachable_twist = state.ramped

    def _measure_truth(self) -> None:
        if not isinstance(self.base, MujocoBase):
            return
        pose = self.base.true_pose()
        turn = math.remainder(pose.yaw - self.true.yaw, math.tau)
        self.turned += turn
        chord = math.hypot(pose.x - self.true.x, pose.y - self.true.y)
        self.path += chord / se2.chord_over_arc(turn)
        self.true = pose
        upright = min(max(self.base.uprightness(), -1.0), 1.0)
        self.largest_tilt = max(self.largest_tilt, math.acos(upright))

    @property
    def tipped(self) -> bool:
        return math.cos(self.largest_tilt) < _TIPPED

    def result(self) -> RobotRun:
        robot = self.robot
        odometry = self.driver.state.pose
        true, path = odometry, self.estimated
        if isinstance(self.base, MujocoBase):
            x, y, _ = self.true.relative_to(self.start)
            true, path = Pose2(x, y, self.turned), self.path
        return RobotRun(
            name=self.name,
            mass=robot.inertial.mass,
            wheels=len(robot.wheels),
            driven=sum(1 for w in robot.wheels if w.driven),
            steered=sum(1 for w in robot.wheels if w.steered),
            path_commanded=self.commanded,
            path_true=path,
            path_odometry=self.estimated,
            end_error=math.hypot(true.x - odometry.x, true.y - odometry.y),
            yaw_error=abs(true.yaw - odometry.yaw),
            pose_true=true,
            pose_odometry=odometry,
            largest_tilt=self.largest_tilt,
            infeasible=self.infeasible,
            unreachable=tuple(robot.wheels[i].name for i in self.unreachable),
            tipped=self.tipped,
        )


class Simulation:
    """A robot, or a fleet in one scene, ready to drive.

    With ``files`` (a build folder, or the outputs of the ``mjcf`` backend as
    ``{path: bytes}``) it drives in MuJoCo, without on ideal joints.
    """

    def __init__(
        self, model: Robot | Fleet, files: Path | str | Mapping[str, bytes] | None = None
    ) -> None:
        """Raises ``RuntimeFault`` where the scene cannot be read or is not of this model."""
        if isinstance(model, Fleet):
            self.robots = [(p.name, p.robot) for p in model.placements]
        else:
            self.robots = [(model.name, model)]
        self.scene = None if files is None else MujocoScene(files)

    def run(
        self,
        duration: float,
        motion: Twist | Manoeuvre | Mapping[str, Manoeuvre],
        report: Report | None = None,
    ) -> SimulationResult:
        """Drive for ``duration`` s from rest and measure.

        ``motion`` is one twist, a manoeuvre for all, or one by robot.  What goes
        wrong on the way (a robot falls over, the simulation diverges, a twist
        cannot be driven) goes to ``report`` and the run ends there.  Raises
        ``RuntimeFault`` where it cannot start.
        """
        if not 0.0 < duration < math.inf:
            raise RuntimeFault("twist-invalid", f"a run of {duration:g} s; it must be positive")
        if self.scene is not None:
            self.scene.reset()
        meters = [
            _Meter(name, robot, self._base(robot), _manoeuvre(motion, name))
            for name, robot in self.robots
        ]
        started = time.perf_counter()
        simulated = 0.0
        stopped = False
        while not stopped:
            meter = min(meters, key=lambda m: m.next)
            if meter.next > duration + 1e-9:
                break
            simulated = meter.next
            meter.tick()
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
            _tell(meters, result, report)
        return result

    def _base(self, robot: Robot) -> BaseHandle:
        return SimBase(robot) if self.scene is None else MujocoBase(robot, self.scene)


def _manoeuvre(motion: Twist | Manoeuvre | Mapping[str, Manoeuvre], name: str) -> Manoeuvre:
    if isinstance(motion, Twist):
        found: Manoeuvre = (Segment(0.0, motion),)
    elif isinstance(motion, Mapping):
        found = motion.get(name, ())
    else:
        found = motion
    for start, twist in found:
        if not (math.isfinite(start) and twist.finite):
            raise RuntimeFault(
                "twist-invalid", f"the twist {tuple(twist)} from {start:g} s on is not finite"
            )
    return found


def _size(twist: Twist) -> float:
    return max(abs(twist.vx), abs(twist.vy), abs(twist.wz))


def _words(twist: Twist) -> str:
    return f"({twist.vx:.3g} m/s, {twist.vy:.3g} m/s, {twist.wz:.3g} rad/s)"


def _tell(meters: Sequence[_Meter], result: SimulationResult, report: Report) -> None:
    if result.diverged:
        report.add(
            "simulation-diverged",
            f"the simulation left all bounds after {result.simulated:.2f} s",
            meters[0].robot.origin,
            hint="look for masses or inertias that are very small beside the forces on them",
        )
        return
    for meter in meters:
        if meter.tipped:
            report.add(
                "simulation-tipped",
                f"{meter.name} fell over after {result.simulated:.2f} s",
                meter.robot.origin,
                hint="lower its speed or accelerations, or its centre of mass, or widen its track",
            )
        if meter.unreachable:
            wheels = ", ".join(meter.robot.wheels[i].name for i in meter.unreachable)
            report.add(
                "steering-unreachable",
                f"{meter.name} cannot steer {wheels} to the motion "
                f"{_words(meter.unreachable_twist)} within the joints' limits",
                meter.robot.origin,
                hint="ask for another motion, or widen the steering limits",
            )
        if _size(meter.infeasible) > _NOTICEABLE and not _only_swing(meter):
            report.add(
                "twist-infeasible",
                f"{meter.name} was asked for {_words(meter.infeasible_twist)}; "
                f"its fixed wheels do not allow {_words(meter.infeasible)} of it",
                meter.robot.origin,
                hint="a robot with fixed wheels cannot move across them",
            )


def _only_swing(meter: _Meter) -> bool:
    """Whether all that was infeasible is the swing of base_link beside the fixed axle.

    Who asks for a turn without saying where an axle lies asks for nothing impossible.
    """
    asked = meter.infeasible_twist
    left = meter.infeasible
    return asked.vy == 0.0 and left.vx == 0.0 and left.wz == 0.0


# -- the demonstration ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DemoRow:
    """A robot's line in the demonstration's table."""

    run: RobotRun
    real_time_factor: float


def load_model(build: Path) -> Robot | Fleet:
    """The model of a build folder.  Raises ``RuntimeFault`` (``model-unreadable``)."""
    path = build / "model.json"
    try:
        return from_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as fault:
        raise RuntimeFault(
            "model-unreadable",
            f"cannot read {path}: {getattr(fault, 'strerror', None) or 'not UTF-8 text'}",
            hint="build the robot first: thorvaldc build",
        ) from fault
    except ModelFormatError as fault:
        raise RuntimeFault(
            "model-unreadable", f"{path}: {fault}", hint="build the robot again"
        ) from fault


def run_demo(build: Path, report: Report) -> list[DemoRow]:
    """Drive what lies in a build folder through its default manoeuvre, in MuJoCo.

    Reads only the generated ``model.json``, ``mjcf/`` and ``meshes/``.  One row
    per robot; none where the report has the reason.
    """
    try:
        model = load_model(build)
        simulation = Simulation(model, build)
        plans = {name: default_manoeuvre(robot) for name, robot in simulation.robots}
        duration = max(end for _, end in plans.values())
        result = simulation.run(duration, {n: plan for n, (plan, _) in plans.items()}, report)
    except RuntimeFault as fault:
        report.put(fault.diagnostic)
        return []
    return [DemoRow(run, result.real_time_factor) for run in result.robots]


def demo_table(rows: Sequence[DemoRow]) -> str:
    """The rows as aligned text with a heading; lengths in m, mass in kg."""
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
                f"{run.path_commanded:.3f} m",
                f"{run.path_true:.3f} m",
                f"{run.path_odometry:.3f} m",
                f"{run.end_error * 1000:.1f} mm",
                f"{row.real_time_factor:.0f}x",
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
