"""End error of the odometry after the paper's drive and after random drives, and its causes."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from itertools import pairwise
from typing import Any
from unittest import mock

import mujoco

from bench.figure import ROOT, Figure
from bench.robots import built, example
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.runtime import driver
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.twist_ramp import Ramp
from thorvaldc.simulation.control_loop import ControlLoop, Manoeuvre, Sample, Segment
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.simulation_run import Simulation

GROUP = "long"

SECONDS = 77.0
RUNS, ABLATED = 20, 8
TRANSITION = 1.5
"""Time (s) after a new command that counts as the transition to it."""
Prepare = Callable[[Simulation], None]


def figures() -> Iterator[Figure]:
    yield _paper()
    robot, files = built(example("6wd6ws_asymmetric"))
    runs = [_run(robot, files, seed) for seed in range(RUNS)]
    end_errors = [end_error for end_error, _ in runs]
    drives = f"{RUNS} random drives of 77 s, about 70 m each, ideal sensors"
    yield Figure(
        "random drives, end error", _rms(end_errors), "m", 0.05, "lower", f"rms of {drives}"
    )
    yield Figure("random drives, worst end error", max(end_errors), "m", None, "lower", drives)
    parts = [_parts(samples, seed) for seed, (_, samples) in enumerate(runs)]
    for name, description in (
        ("heading, in transitions", "heading errors while the motion changes"),
        ("heading, in steady motion", "heading errors in steady motion"),
        ("position", "position errors: creep of the contacts"),
    ):
        lengths = [part[name] for part in parts]
        yield Figure(
            f"random drives, {name}",
            _rms(lengths),
            "m",
            None,
            "lower",
            f"part of the end error: {description}",
        )
    whole = _rms(end_errors[:ABLATED])
    for name, patch, prepare in _ablations():
        with patch:
            end_error = _rms([_run(robot, files, seed, prepare)[0] for seed in range(ABLATED)])
        yield Figure(
            f"random drives, {name}",
            end_error,
            "m",
            None,
            "lower",
            f"rms of the first {ABLATED}; without this change {whole:.3f} m",
        )


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values))


def _paper() -> Figure:
    scenario = compile_file(ROOT / "examples" / "odometry_experiment" / "ideal.yaml").scenario
    if scenario is None:
        raise SystemExit("the experiment does not compile")
    files = emit(scenario.fleet, ["mjcf"], Report())
    run = ScenarioSimulation(scenario, files).play(Report()).run.robots[0]
    how = f"ideal sensors, {run.path_true:.2f} m, odometry {run.path_odometry:.2f} m"
    return Figure("the paper's drive, end error", run.end_error, "m", 0.05, "lower", how)


def random_drive(seed: int) -> Manoeuvre:
    """Returns twists of all directions, each for 4 to 9 s, with sudden changes between them."""
    rng = random.Random(seed)
    time, drive = 0.0, []
    while time < 70.0:
        length, speed = rng.uniform(4.0, 9.0), rng.uniform(0.9, 1.3)
        angle = rng.uniform(-math.pi, math.pi)
        twist = Twist(speed * math.cos(angle), speed * math.sin(angle), rng.uniform(-0.4, 0.4))
        drive.append(Segment(time, twist))
        time += length
    return [*drive, Segment(SECONDS - 3.0, ZERO_TWIST)]


def _run(
    robot: Robot, files: dict[str, bytes], seed: int, prepare: Prepare | None = None
) -> tuple[float, list[Sample]]:
    simulation = Simulation(robot, files)
    if prepare is not None:
        prepare(simulation)
    samples: list[Sample] = []

    def on_tick(loop: ControlLoop) -> None:
        samples.append(loop.sample())

    run = simulation.run(SECONDS, random_drive(seed), None, on_tick).robots[0]
    return run.end_error, samples


def _parts(samples: list[Sample], seed: int) -> dict[str, float]:
    """Returns parts of the end error (m): the sum of each tick's error, as seen at the end.

    A heading error of a tick moves the end by the error times the lever arm from the robot to
    the end; a position error moves the end by itself.
    """
    starts = [segment.start for segment in random_drive(seed)]
    end = samples[-1].pose_estimated
    transition, steady, position = names = (
        "heading, in transitions",
        "heading, in steady motion",
        "position",
    )
    parts = {name: [0.0, 0.0] for name in names}
    for a, b in pairwise(samples):
        true = b.pose_true.relative_to(a.pose_true)
        estimated = b.pose_estimated.relative_to(a.pose_estimated)
        dx, dy, turn = (t - e for t, e in zip(true, estimated, strict=True))
        c, s = math.cos(a.pose_estimated.yaw), math.sin(a.pose_estimated.yaw)
        shift = parts[position]
        shift[0] += c * dx - s * dy
        shift[1] += s * dx + c * dy
        in_transition = any(0.0 <= b.time - start < TRANSITION for start in starts)
        heading = parts[transition if in_transition else steady]
        heading[0] -= turn * (end.y - b.pose_estimated.y)
        heading[1] += turn * (end.x - b.pose_estimated.x)
    return {name: math.hypot(*part) for name, part in parts.items()}


# -- ablations: each run lacks one measure against the error -----------------------------------


def _ablations() -> Iterator[tuple[str, AbstractContextManager[Any], Prepare | None]]:
    # `__name__` instead of a text: mypy reports a method that was renamed.
    patch = mock.patch.object
    lag, delay = MujocoBase._lag.__name__, General._steering_delay.__name__
    yield "servos without feed-forward", patch(MujocoBase, lag, _no_lag), None
    yield "ramps with corners", patch(driver, Ramp.__name__, _ramp_with_corners), None
    yield "no waiting for late wheels", patch(General, delay, _no_delay), None
    yield "implicit integration", nullcontext(), _implicit_integration
    yield "steps of 1 ms", nullcontext(), _short_steps


def _no_lag(base: MujocoBase, motor: int) -> float:
    return 0.0


def _ramp_with_corners(settings: Any, length: float, smoothing: float) -> Ramp:
    return Ramp(settings, length, 0.0)


def _no_delay(calculator: General, dt: float | None) -> Any:
    return (0.0,) * len(calculator.geometry.wheels), 0.0, True


def _implicit_integration(simulation: Simulation) -> None:
    if simulation.scene is not None:
        integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        simulation.scene.model.opt.integrator = integrator


def _short_steps(simulation: Simulation) -> None:
    if simulation.scene is not None:
        simulation.scene.model.opt.timestep = simulation.scene.timestep = 0.001
