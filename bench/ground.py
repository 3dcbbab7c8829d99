"""Zones and rails of scenarios against closed-form answers."""

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

SLIM = ROOT / "examples" / "4wd4ws_slim" / "robot.yaml"
CART = ROOT / "examples" / "2wd0ws_greenhouse" / "robot.yaml"
ANGLE, MU, SECONDS = math.radians(8.0), 0.06, 2.0
MUD = 0.15


def figures() -> Iterator[Figure]:
    slope = f"ground: {{type: slope, angle: {math.degrees(ANGLE):g} deg}}"
    zone = f"zones: [{{xyz: [-5, 0, 0], size: [14, 4], friction: {MU}}}]"
    _, samples = _played(SLIM, f"duration: {SECONDS}\nworld: {{{slope}, {zone}}}\n")
    wanted = 0.5 * 9.81 * (math.sin(ANGLE) - MU * math.cos(ANGLE)) * SECONDS**2
    yield Figure(
        "sliding on ice",
        100 * abs(-samples[-1].pose_true.x / wanted - 1.0),
        "%",
        1.0,
        "lower",
        "way down 8 deg of a 4WD4WS that brakes, in 2 s, in a zone of friction 0.06, against"
        " g (sin - mu cos) t^2/2",
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
    found, path = mud.metrics["cart"], mud.metrics["cart"]["path"]
    resistance = MUD - robot.wheels[0].rolling_resistance
    wanted = resistance * robot.inertial.mass * 9.81 * path
    yield Figure(
        "work in mud",
        100 * abs((found["energy"] - firm.metrics["cart"]["energy"]) / wanted - 1.0),
        "%",
        0.5,
        "lower",
        f"that the motors do more in a zone of rolling resistance {MUD}, against its"
        " coefficient, the weight and the way",
    )
    rails = "world: {rails: [{from: [-1 m, 0], to: [6 m, 0], gauge: 720 mm}]}\n"
    result, samples = _played(
        CART, f"duration: 8\n{rails}script: [{{at: 1, vx: 0.5}}, {{at: 7}}]\n", "16 mm", "rail"
    )
    first, last = (next(s for s in samples if s.time >= t) for t in (2.5, 6.5))
    if first.joints is None or last.joints is None:
        raise SystemExit("no joints")
    turned = (last.joints.positions or [])[0] - (first.joints.positions or [])[0]
    way = last.pose_true.x - first.pose_true.x
    yield Figure(
        "way on rails",
        100 * abs(way / turned / 0.09 - 1.0),
        "%",
        0.01,
        "lower",
        "of the greenhouse robot on pipes, against the radius of its rail wheels, 90 mm; its"
        f" odometry with that set: {result.metrics['cart']['end_error'] * 1000:.1f} mm off after"
        f" {result.metrics['cart']['path']:.1f} m",
    )


def _played(
    robot: Path, text: str, height: str = "0", parameters: str | None = None
) -> tuple[ScenarioResult, list[Sample]]:
    robots = f"robots: {{cart: {{robot: {robot}, xyz: [0, 0, {height}]}}}}\n"
    with TemporaryDirectory() as folder:
        path = Path(folder, "scenario.yaml")
        path.write_text(f"thorvaldc: 1\nscenario: bench\n{robots}{text}", encoding="utf-8")
        done = compile_file(path)
        if done.scenario is None:
            raise SystemExit("; ".join(d.message for d in done.report))
    simulation = ScenarioSimulation(done.scenario, emit(done.scenario.fleet, ["mjcf"]), parameters)
    samples: list[Sample] = []
    result = simulation.play(Report(), on_tick=lambda loop: samples.append(loop.sample()))
    return result, samples
