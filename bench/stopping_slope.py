"""Stops on slopes: the closed form of the model compared with MuJoCo.

Robots with few driven wheels drive straight downhill, forwards and backwards, and get the command
to stop.  On some slopes they follow the ramp of the driver, on others the wheels with motors slide.
The closed form has the deceleration of ``model.statics.slope`` and a reaction time of one
control cycle, because these runs have no bus.

Then every example, as it is and with a heavy block high above its frame, stops on the steepest
slope that the model states for it, in each direction in which its wheels roll, with the ramp of its
file and with a gentle one.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from bench.figure import Figure
from bench.robots import example
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.model.statics.slope import DIRECTIONS, directions_of
from thorvaldc.model.statics.slope_stops import SlopeStop, SlopeStops
from thorvaldc.model.stopping import STOP_LOCK
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.episode import Episode

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
    direction: str


CASES = (
    Case("1wd1ws_front", 12.0, "backwards"),
    Case("1wd1ws_front", 9.0, "backwards"),
    Case("1wd1ws_front", 12.0, "forwards"),
    Case("1wd1ws_rear", 12.0, "forwards"),
    Case(ROVER, 14.0, "backwards"),
    Case(ROVER, 17.0, "backwards"),
    Case("2wd0ws_greenhouse", 14.0, "backwards"),
    Case(WEAK, 12.0, "forwards"),
    Case(WEAK, 15.0, "forwards"),
    Case("lss", 12.0, "backwards"),
    Case("4wd4ws_wide", 25.0, "backwards"),
)
DRIVEN = 6.0
"""Time (s) for which the robots drive before the command to stop."""
REST = 0.01
"""Speed (m/s) below which a robot stands."""
LONGEST = 20.0
"""Time (s) after which a robot that still moves does not stop."""


class Closing(NamedTuple):
    """A stop on the steepest slope that the model states.

    - ``slope``: the slope in deg; ``level``: stopping distance in m on level ground;
      ``measured``: stopping distance in m in MuJoCo, infinite if the robot tips over or rolls on.
    """

    slope: float
    level: float
    measured: float

    @property
    def longer(self) -> float:
        """By which share of the distance on level ground the stop is longer."""
        return self.measured / self.level - 1.0


FAMILIES = (
    *("1wd1ws_front", "1wd1ws_rear", "2wd0ws_greenhouse", "4wd2ws_tall", "4wd4ws_slim"),
    *("4wd4ws_wide", "6wd6ws", "6wd6ws_asymmetric", "9wd9ws", "car", "lss", "rocker_bogie"),
)
BLOCK = """
thorvaldc: 1
description: Heavy block.
mount: {kinds: [frame_clamp], link: block, xyz: [0, 0, 0]}
links:
  block:
    parts:
      - shape: {box: [0.3, 0.3, 0.3]}
        mass: 80 kg
        source: "estimated: a tank full of water"
"""
HEIGHT = 1.5
"""Height (m) of the block above the frame."""
GENTLE = 0.25
"""Deceleration (m/s^2) of a gentle stop, which lasts long enough for a robot to tip over."""


def loaded(text: str) -> str:
    """Returns the text of a robot file with the heavy block, whose module is in ``lib``."""
    text = re.sub(r"^design:.*\n", "", text, flags=re.MULTILINE)
    block = f"ballast: {{type: heavy/block, mount: {{parent: frame, xyz: [0, 0, {HEIGHT}]}}}}"
    return text.replace("modules:\n", f"library: [lib]\nmodules:\n  {block}\n", 1)


def steepest_stop(robot: str, direction: str, *, block: bool = False, driver: str = "") -> Closing:
    """Returns the stop of an example, or of the text of a robot file, on the slope that the model
    states for a stop command.

    ``block``: with the heavy block.  ``driver``: section of the robot file, such as
    ``{max_linear_deceleration: 0.25 m/s^2}``.
    """
    with TemporaryDirectory() as name:
        folder = Path(name, "robot")
        robot_file = folder / "robot.yaml"
        if "\n" in robot:
            folder.mkdir()
            robot_file.write_text(robot, encoding="utf-8")
        else:
            shutil.copytree(example(robot).parent, folder)
        text = robot_file.read_text(encoding="utf-8")
        if block:
            module = folder / "lib/heavy/block/module.yaml"
            module.parent.mkdir(parents=True)
            module.write_text(BLOCK, encoding="utf-8")
            text = loaded(text)
        if driver:
            text = re.sub(r"^driver:.*\n(  .*\n)*", "", text, flags=re.MULTILINE)
            text += f"driver: {driver}\n"
        robot_file.write_text(text, encoding="utf-8")
        model = _model(robot_file)
        stops = SlopeStops(model, DIRECTIONS[direction])
        stop = _stop_command(stops)
        stops.stops = (stop,)
        slope = math.degrees(stops.steepest())
        return Closing(
            slope,
            stop._replace(reaction=0.0).distance(stop.needed),
            _measured(Case(robot, slope, direction), robot_file, model),
        )


def stopping_distances(case: Case) -> tuple[float, float]:
    """Returns the stopping distances (m) of the closed form and of MuJoCo."""
    with TemporaryDirectory() as folder:
        robot_file = example(case.robot)
        if "\n" in case.robot:
            robot_file = Path(folder, "robot.yaml")
            robot_file.write_text(case.robot, encoding="utf-8")
        robot = _model(robot_file)
        measured = _measured(case, robot_file, robot)
    stops = SlopeStops(robot, DIRECTIONS[case.direction])
    stop = _stop_command(stops)
    deceleration = stops.deceleration(math.radians(case.slope), stop)
    stop = stop._replace(reaction=1.0 / robot.driver.rate)
    return stop.distance(deceleration), measured


def _model(robot_file: Path) -> Robot:
    compilation = compile_file(robot_file)
    if not isinstance(compilation.model, Robot):
        raise SystemExit("; ".join(d.message for d in compilation.report))
    return compilation.model


def _stop_command(stops: SlopeStops) -> SlopeStop:
    return next(stop for stop in stops.stops if stop.kind == STOP_LOCK)


def _measured(case: Case, robot_file: Path, robot: Robot) -> float:
    """Returns the distance (m) from the command to stop to the standstill, or infinity."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "scenario.yaml")
        path.write_text(_scenario(case, robot_file, robot), encoding="utf-8")
        compilation = compile_file(path)
        scenario = compilation.scenario
        if scenario is None:
            raise SystemExit("; ".join(d.message for d in compilation.report))
        episode = Episode(scenario)
    rest: list[Sample] = []

    def observe(loop: ControlLoop) -> None:
        sample = loop.sample()
        if sample.time >= DRIVEN - 1e-9 and (
            not rest or math.hypot(rest[-1].true.vx, rest[-1].true.vy) >= REST
        ):
            rest.append(sample)

    episode.reset()
    episode.run(DRIVEN + LONGEST, on_tick=observe)
    if episode.ended or math.hypot(rest[-1].true.vx, rest[-1].true.vy) >= REST:
        return math.inf
    start, end = rest[0].pose_true, rest[-1].pose_true
    return math.hypot(end.x - start.x, end.y - start.y)


def _scenario(case: Case, robot_file: Path, robot: Robot) -> str:
    """Returns a scenario in which the robot drives straight downhill and stops."""
    x, y = DIRECTIONS[case.direction]
    speed, uphill = robot.driver.max_linear_velocity, math.degrees(math.atan2(-y, -x))
    return (
        f"thorvaldc: 1\nscenario: stop\nduration: {DRIVEN + LONGEST}\n"
        f"robots: {{cart: {{robot: {robot_file}}}}}\n"
        f"world: {{ground: {{type: slope, angle: {case.slope} deg, direction: {uphill} deg}}}}\n"
        f"script: [{{at: 0, vx: {speed * x}, vy: {speed * y}}}, {{at: {DRIVEN}}}]\n"
    )


def steepest_stops() -> Iterator[tuple[str, Closing]]:
    """Yields the stop of each example on its steepest slope in each direction, with its names."""
    for name in FAMILIES:
        for direction in directions_of(_model(example(name))):
            for block in (False, True):
                for driver in ("", f"{{max_linear_deceleration: {GENTLE} m/s^2}}"):
                    closing = steepest_stop(name, direction, block=block, driver=driver)
                    kind = f"{'gentle' if driver else 'own'} ramp{', loaded' if block else ''}"
                    yield f"{name:<18} {direction:<9} {kind:<20}", closing


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
    closings = [closing for _, closing in steepest_stops()]
    yield Figure(
        "stop on the steepest slope",
        100.0 * max(closing.longer for closing in closings),
        "%",
        6.0,
        "lower",
        f"longest of {len(closings)} stops in MuJoCo on the stated slope, over level ground",
    )


def main() -> None:
    """Prints both distances of each case, and the stops on the steepest slopes."""
    for case in CASES:
        model, measured = stopping_distances(case)
        name = {ROVER: "rover", WEAK: "weak"}.get(case.robot, case.robot)
        print(
            f"{name:<20} {case.slope:4.0f} deg {case.direction:<9} closed form {model:6.3f} m, "
            f"MuJoCo {measured:6.3f} m ({100.0 * (model / measured - 1.0):+.1f} %)",
            flush=True,
        )
    for name, (slope, level, measured) in steepest_stops():
        print(
            f"{name} {slope:5.1f} deg, level {level:6.3f} m, MuJoCo {measured:6.3f} m "
            f"({100.0 * (measured / level - 1.0):+.1f} %)",
            flush=True,
        )


if __name__ == "__main__":
    main()
