"""Stopping distances on slopes: the closed form of the model compared with MuJoCo.

Robots with few driven wheels drive straight downhill, forwards and backwards, and get the command
to stop.  On some slopes they follow the ramp of the driver, on others the wheels with motors slide.
The closed form has the deceleration of ``model.statics.slope`` and a reaction time of one
control cycle, because these runs have no bus.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from bench.figure import ROOT, Figure
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.statics.slope import SlopeStops
from thorvaldc.model.stopping import STOP_LOCK
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.scenario_run import ScenarioSimulation

GROUP = "long"

ROVER = """
thorvaldc: 1
name: rover
base_calculator: differential
modules:
  frame: {type: frame/tube_rectangular, params: {cross_members: [-100 mm]}}
  left: {type: assembly/fixed_drive, mount: frame.front_left}
  right: {type: assembly/fixed_drive, mount: frame.front_right}
  controller:
    type: controller/propulsion_propulsion
    channels: {left: left.propulsion, right: right.propulsion}
    can: 1
  caster_left: {type: caster/swivel, mount: frame.rear_left}
  caster_right: {type: caster/swivel, mount: frame.rear_right}
  battery:
    type: battery/enclosure
    mount: {parent: frame, xyz: [-100 mm, 0, 70 mm], rpy: [0, 0, 90 deg]}
    can: 1
"""
"""A robot of which two of four wheels are driven."""
WEAK = ROVER.replace("rover", "weak").replace(
    "modules:", "defaults: {drive: {max_torque: 30 N m}}\nmodules:"
)
"""The same robot with motors that are weaker than the grip of their wheels."""


class Case(NamedTuple):
    """A stop: an example or the text of a robot file, the slope in deg, and the direction."""

    robot: str
    slope: float
    backwards: bool


CASES = (
    Case("1wd1ws_front", 12.0, True),
    Case("1wd1ws_front", 9.0, True),
    Case("1wd1ws_front", 12.0, False),
    Case("1wd1ws_rear", 12.0, False),
    Case(ROVER, 14.0, True),
    Case(ROVER, 17.0, True),
    Case("2wd0ws_greenhouse", 14.0, True),
    Case(WEAK, 12.0, False),
    Case(WEAK, 15.0, False),
    Case("lss", 12.0, True),
    Case("4wd4ws_wide", 25.0, True),
)
DRIVEN = 6.0
"""Time (s) for which the robots drive before the command to stop."""
REST = 0.01
"""Speed (m/s) below which a robot stands."""
LONGEST = 20.0
"""Time (s) after which a robot that still moves does not stop."""


def stopping_distances(case: Case) -> tuple[float, float]:
    """Returns the stopping distances (m) of the closed form and of MuJoCo."""
    with TemporaryDirectory() as folder:
        robot_file = ROOT / "examples" / case.robot / "robot.yaml"
        if "\n" in case.robot:
            robot_file = Path(folder, "robot.yaml")
            robot_file.write_text(case.robot, encoding="utf-8")
        robot = compile_file(robot_file).model
        if not isinstance(robot, Robot):
            raise SystemExit(f"{robot_file} does not compile")
        path = Path(folder, "scenario.yaml")
        speed = robot.driver.max_linear_velocity
        path.write_text(_scenario(case, robot_file, speed), encoding="utf-8")
        compilation = compile_file(path)
        scenario = compilation.scenario
        if scenario is None:
            raise SystemExit("; ".join(d.message for d in compilation.report))
        measured = _measure(ScenarioSimulation(scenario, emit(scenario.fleet, ["mjcf"])))
    stops = SlopeStops(robot)
    stop = next(stop for stop in stops.stops if stop.kind == STOP_LOCK)
    deceleration = stops.deceleration(math.radians(case.slope), stop, backwards=case.backwards)
    stop = stop._replace(reaction=1.0 / robot.driver.rate)
    return stop.distance(deceleration), measured


def _scenario(case: Case, robot: Path, speed: float) -> str:
    """Returns a scenario in which the robot drives straight downhill and stops."""
    velocity, uphill = (-speed, 0) if case.backwards else (speed, 180)
    return (
        f"thorvaldc: 1\nscenario: stop\nduration: {DRIVEN + LONGEST}\n"
        f"robots: {{cart: {{robot: {robot}}}}}\n"
        f"world: {{ground: {{type: slope, angle: {case.slope} deg, direction: {uphill} deg}}}}\n"
        f"script: [{{at: 0, vx: {velocity}}}, {{at: {DRIVEN}}}]\n"
    )


def _measure(simulation: ScenarioSimulation) -> float:
    """Returns the distance (m) from the command to stop to the standstill, or infinity."""
    samples: list[Sample] = []
    simulation.play(Report(), on_tick=lambda loop: samples.append(loop.sample()), hashed=False)
    stopping = [sample for sample in samples if sample.time >= DRIVEN - 1e-9]
    rest = next((s for s in stopping if abs(s.true.vx) < REST), None)
    return math.inf if rest is None else abs(rest.pose_true.x - stopping[0].pose_true.x)


def figures() -> Iterator[Figure]:
    """Yields the largest difference between the closed form and MuJoCo."""
    errors = [abs(model / measured - 1.0) for model, measured in map(stopping_distances, CASES)]
    yield Figure(
        "stopping distance on slopes",
        100.0 * max(errors),
        "%",
        10.0,
        "lower",
        f"largest difference of {len(CASES)} stops downhill in MuJoCo from the closed form",
    )


def main() -> None:
    """Prints both distances of each case."""
    for case in CASES:
        model, measured = stopping_distances(case)
        name = {ROVER: "rover", WEAK: "weak"}.get(case.robot, case.robot)
        direction = "backwards" if case.backwards else "forwards"
        print(
            f"{name:<20} {case.slope:4.0f} deg {direction:<9} closed form {model:6.3f} m, "
            f"MuJoCo {measured:6.3f} m ({100.0 * (model / measured - 1.0):+.1f} %)",
            flush=True,
        )


if __name__ == "__main__":
    main()
