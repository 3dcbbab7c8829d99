"""Runs scenarios: faults and noise, what is measured, and whether it is as expected."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.scenario import Expectation, Scenario
from thorvaldc.runtime.base_interface import BaseHandle
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.drive_metrics import Meter, RobotRun, Watch
from thorvaldc.simulation.manoeuvre import Segment
from thorvaldc.simulation.physics.collisions import Contacts, Rings
from thorvaldc.simulation.physics.faulty_base import FaultyBase
from thorvaldc.simulation.records.record_writer import Digest, Recorder
from thorvaldc.simulation.simulation_run import Simulation, SimulationResult

UNITS = {
    "end_error": "m",
    "yaw_error": "rad",
    "path": "m",
    "length_ratio": "",
    "tilt": "rad",
    "slip": "m/s",
    "largest_slip": "m/s",
    "steering_limit_hits": "",
    "collisions": "",
    "energy": "J",
}
"""What is measured of every robot, in this order, and in which unit."""
_AT_LIMIT = math.radians(0.2)
_MOVING = 1e-3
"""Length (m) of a path below which the ratio of two says nothing."""


@dataclass(frozen=True, slots=True)
class Check:
    """An expectation of one robot, and what came of it."""

    robot: str
    metric: str
    value: float
    least: float | None
    most: float | None
    span: Span

    @property
    def passed(self) -> bool:
        """Whether the value is a number within the bounds."""
        low = self.least is None or self.value >= self.least
        return math.isfinite(self.value) and low and (self.most is None or self.value <= self.most)

    @property
    def bounds(self) -> str:
        unit = UNITS[self.metric]
        found = [f"at least {_said(self.least, unit)}"] if self.least is not None else []
        found += [f"at most {_said(self.most, unit)}"] if self.most is not None else []
        return " and ".join(found)

    @property
    def words(self) -> str:
        return _said(self.value, UNITS[self.metric])


def _said(value: float, unit: str) -> str:
    if unit == "rad":
        return f"{math.degrees(value):.4g} deg"
    return f"{value:.4g} {unit}".rstrip()


@dataclass(frozen=True, slots=True)
class ScenarioResult:
    """A scenario's run: ``metrics`` by robot and name in SI, the ``checks``, and a hash.

    ``hash`` is over every number of every tick: equal for equal runs.
    """

    scenario: str
    run: SimulationResult
    metrics: Mapping[str, Mapping[str, float]]
    checks: tuple[Check, ...]
    hash: str

    @property
    def completed(self) -> bool:
        """Whether it ran to the end, with every robot on its wheels."""
        return not self.run.diverged and not any(robot.tipped for robot in self.run.robots)

    @property
    def passed(self) -> bool:
        return self.completed and all(check.passed for check in self.checks)

    def as_json(self) -> dict[str, Any]:
        """The result as plain values."""
        checks = [
            {
                "robot": check.robot,
                "metric": check.metric,
                "value": check.value,
                "min": check.least,
                "max": check.most,
                "passed": check.passed,
            }
            for check in self.checks
        ]
        return {
            "scenario": self.scenario,
            "passed": self.passed,
            "completed": self.completed,
            "hash": self.hash,
            "checks": checks,
            "metrics": {name: dict(values) for name, values in self.metrics.items()},
            "run": self.run.as_json(),
        }


class ScenarioSimulation(Simulation):
    """A scenario's robots in its world, ready to drive."""

    def __init__(
        self,
        scenario: Scenario,
        files: Path | str | Mapping[str, bytes],
        parameters: str | None = None,
    ) -> None:
        """``files`` are the outputs of the ``mjcf`` backend for ``scenario.fleet``.

        ``parameters`` names the set that the robots drive by to begin with.  Raises
        ``DiagnosticError`` where the scene cannot be read, or a robot has no such set.
        """
        super().__init__(scenario.fleet, files, parameters)
        self.scenario = scenario
        world = scenario.fleet.world
        self._zones = world.zones if world is not None else ()
        # By robot the parameter sets of its script, and from when on.
        self._changes = {
            name: [(c.time, c.parameters) for c in commands if c.parameters]
            for name, commands in scenario.commands
        }

    def play(
        self,
        report: Report,
        recorders: Sequence[Recorder] = (),
        watch: Watch | None = None,
    ) -> ScenarioResult:
        """Run it.  What goes wrong, and what is not as expected, goes to ``report``.

        ``recorders`` get every tick of every robot; they are not closed here.  Raises
        ``DiagnosticError`` where it cannot start.
        """
        scene = self.scene
        if scene is None:
            raise DiagnosticError("simulation-scene", "a scenario needs a scene")
        digest = Digest()
        everywhere = (digest, *recorders)
        contacts = Contacts(scene, dict(self.robots))
        observers: dict[str, Observer] = {}

        def observe(meter: Meter) -> None:
            found = observers.get(meter.name)
            if found is None:
                found = observers[meter.name] = Observer(meter, contacts)
            command = meter.driver.state.command
            sample, joints = meter.sample(), None if command is None else command.joints
            found.tick(sample.true)
            self._change_parameters(meter)
            for recorder in everywhere:
                recorder.record(meter.name, sample, joints)
            if watch is not None:
                watch(meter)

        plans = {
            name: tuple(Segment(c.time, Twist(c.vx, c.vy, c.wz)) for c in commands)
            for name, commands in self.scenario.commands
        }
        self._bases: list[FaultyBase] = []
        try:
            run = self.run(self.scenario.duration, plans, report, observe)
        finally:
            for base in self._bases:
                base.close()
        metrics = {
            robot.name: _metrics(robot, observers[robot.name], contacts) for robot in run.robots
        }
        checks = tuple(
            _check(name, values, expectation)
            for expectation in self.scenario.expectations
            for name, values in metrics.items()
        )
        for check in checks:
            if not check.passed:
                report.add(
                    "expectation-failed",
                    f"`{check.metric}` of {check.robot} is {check.words}; "
                    f"{check.bounds} is expected",
                    check.span,
                )
        return ScenarioResult(self.scenario.name, run, metrics, checks, digest.hexdigest())

    def _change_parameters(self, meter: Meter) -> None:
        """Switch to the sets of the script; what is staged now is in force with the next tick."""
        before, now = meter.driver.state.time, meter.next
        for start, parameters in self._changes.get(meter.name, ()):
            if before < start - 1e-9 <= now or start == before == 0.0:
                meter.driver.use(parameters)

    def _base(self, name: str, robot: Robot) -> BaseHandle:
        if self.scene is None:
            return super()._base(name, robot)
        faults = [fault for fault in self.scenario.faults if fault.robot == name]
        base = FaultyBase(robot, self.scene, faults, self.scenario.noise, self._zones)
        self._bases.append(base)
        return base


class Observer:
    """What is measured of a robot beside what its meter does: slip, limits, energy."""

    def __init__(self, meter: Meter, contacts: Contacts) -> None:
        base = meter.base
        if not isinstance(base, FaultyBase):
            raise TypeError("only robots of a scenario are observed")
        import numpy

        self.meter = meter
        self.base = base
        self.contacts = contacts
        wheels = BaseGeometry.from_robot(meter.robot).wheels
        self.rolling = [(i, w) for i, w in enumerate(wheels) if w.driven and not w.swivel]
        # Between which angles each steering joint is not at its limits.
        self.limits = [
            (
                i,
                -math.inf if w.lower is None else w.lower + _AT_LIMIT,
                math.inf if w.upper is None else w.upper - _AT_LIMIT,
            )
            for i, w in enumerate(wheels)
            if w.steered
        ]
        self.motors = numpy.array(base.motors(), dtype=int)
        rings = any(wheel.treads for wheel in meter.robot.wheels)
        self.rings = Rings(meter.robot, base.scene) if rings else None
        self.time = 0.0
        self.energy = 0.0
        self.slip_squares = 0.0
        self.slips = 0
        self.largest_square = 0.0
        self.limit_hits = 0
        self.at_limit = [False] * len(wheels)

    def tick(self, twist: Twist) -> None:
        """Look at what the last tick left; ``twist`` is the true one."""
        data = self.base.scene.data
        now = self.meter.driver.state.time
        dt, self.time = now - self.time, now
        forces, speeds = data.actuator_force[self.motors], data.actuator_velocity[self.motors]
        for power in (forces * speeds).tolist():
            if power > 0.0:
                self.energy += power * dt
        vx, vy, wz = twist
        joints = self.base.actual
        radii = self.rings.radii() if self.rings is not None else None
        for i, wheel in self.rolling:
            turning = wheel.sign * joints.angle_rates[i]
            (l1, l2, l3), (t1, t2, t3) = wheel.rows(joints.angles[i])
            along, across = l1 * vx + l2 * vy + l3 * wz, t1 * vx + t2 * vy + t3 * wz
            # The contact moves about the steering axis too, where it lies beside it.
            radius = wheel.radius if radii is None else radii[i]
            along -= wheel.lateral * turning + radius * joints.speeds[i]
            across += wheel.trail * turning
            square = along * along + across * across
            self.slip_squares += square
            if square > self.largest_square:
                self.largest_square = square
        self.slips += len(self.rolling)
        for i, least, most in self.limits:
            hit = not least <= joints.angles[i] <= most
            self.limit_hits += hit and not self.at_limit[i]
            self.at_limit[i] = hit
        self.contacts.look()


def _metrics(run: RobotRun, observer: Observer, contacts: Contacts) -> dict[str, float]:
    known = run.path_odometry > _MOVING and run.path_true > _MOVING
    values = {
        "end_error": run.end_error,
        "yaw_error": run.yaw_error,
        "path": run.path_true,
        "length_ratio": run.path_true / run.path_odometry if known else 1.0,
        "tilt": run.largest_tilt,
        "slip": math.sqrt(observer.slip_squares / max(observer.slips, 1)),
        "largest_slip": math.sqrt(observer.largest_square),
        "steering_limit_hits": float(observer.limit_hits),
        "collisions": float(contacts.collisions[run.name]),
        "energy": observer.energy,
    }
    return {name: values[name] for name in UNITS}


def _check(robot: str, values: Mapping[str, float], wanted: Expectation) -> Check:
    value = values[wanted.metric]
    return Check(robot, wanted.metric, value, wanted.least, wanted.most, wanted.span)
