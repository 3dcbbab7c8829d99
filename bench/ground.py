"""Zones and rails of scenarios compared with closed-form results."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.figure import ROOT, Figure
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.scenario_run import ScenarioResult, ScenarioSimulation

GROUP = "long"

SLIM = ROOT / "examples" / "4wd4ws_slim" / "robot.yaml"
CART = ROOT / "examples" / "2wd0ws_greenhouse" / "robot.yaml"
ANGLE, MU, SECONDS = math.radians(8.0), 0.06, 2.0
MUD = 0.15


def figures() -> Iterator[Figure]:
    slope = f"ground: {{type: slope, angle: {math.degrees(ANGLE):g} deg}}"
    zone = f"zones: [{{xyz: [-5, 0, 0], size: [14, 4], friction: {MU}}}]"
    _, samples = _played(SLIM, f"duration: {SECONDS}\nworld: {{{slope}, {zone}}}\n")
    expected = 0.5 * 9.81 * (math.sin(ANGLE) - MU * math.cos(ANGLE)) * SECONDS**2
    yield Figure(
        "sliding on ice",
        100 * abs(-samples[-1].pose_true.x / expected - 1.0),
        "%",
        1.0,
        "lower",
        "distance that a braking 4WD4WS slides down 8 deg in 2 s, in a zone of friction 0.06,"
        " compared with g (sin - mu cos) t^2/2",
    )
    drive = "duration: 8\nscript: [{at: 0, vx: 0.8}]\n"
    firm, _ = _played(SLIM, drive)
    mud, _ = _played(
        SLIM,
        drive
        + f"world: {{zones: [{{xyz: [0, 0, 0], size: [40, 4], rolling_resistance: {MUD}}}]}}\n",
    )
    robot = compile_file(SLIM).model
    if not isinstance(robot, Robot):
        raise SystemExit(f"{SLIM} does not compile")
    energy, path = mud.metrics["cart"]["energy"], mud.metrics["cart"]["path"]
    resistance = MUD - robot.wheels[0].rolling_resistance
    expected = resistance * robot.inertial.mass * 9.81 * path
    yield Figure(
        "work in mud",
        100 * abs((energy - firm.metrics["cart"]["energy"]) / expected - 1.0),
        "%",
        0.5,
        "lower",
        f"extra work of the motors in a zone of rolling resistance {MUD}, compared with"
        " coefficient * weight * distance",
    )
    rails = "world: {rails: [{from: [-1 m, 0], to: [6 m, 0], gauge: 720 mm}]}\n"
    result, samples = _played(
        CART, f"duration: 8\n{rails}script: [{{at: 1, vx: 0.5}}, {{at: 7}}]\n", "16 mm", "rail"
    )
    first, last = (next(s for s in samples if s.time >= t) for t in (2.5, 6.5))
    if first.joints is None or last.joints is None:
        raise SystemExit("no joints")
    angle = (last.joints.positions or [])[0] - (first.joints.positions or [])[0]
    distance = last.pose_true.x - first.pose_true.x
    yield Figure(
        "distance on rails",
        100 * abs(distance / angle / 0.09 - 1.0),
        "%",
        0.01,
        "lower",
        "of the greenhouse robot on pipes, compared with the radius of its rail wheels, 90 mm;"
        " end error of its odometry with that set:"
        f" {result.metrics['cart']['end_error'] * 1000:.1f} mm after"
        f" {result.metrics['cart']['path']:.1f} m",
    )


def _played(
    robot: Path, text: str, height: str = "0", parameters: str | None = None
) -> tuple[ScenarioResult, list[Sample]]:
    robots = f"robots: {{cart: {{robot: {robot}, xyz: [0, 0, {height}]}}}}\n"
    with TemporaryDirectory() as folder:
        path = Path(folder, "scenario.yaml")
        path.write_text(f"thorvaldc: 1\nscenario: bench\n{robots}{text}", encoding="utf-8")
        compilation = compile_file(path)
        scenario = compilation.scenario
        if scenario is None:
            raise SystemExit("; ".join(d.message for d in compilation.report))
    simulation = ScenarioSimulation(scenario, emit(scenario.fleet, ["mjcf"]), parameters)
    samples: list[Sample] = []
    result = simulation.play(Report(), on_tick=lambda loop: samples.append(loop.sample()))
    return result, samples
