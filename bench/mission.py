"""A mission as long as the paper's with all that runs on a robot, against real time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bench.figure import Figure, least_times
from bench.robots import built, example
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Placement, Pose
from thorvaldc.model.scenario import Command, Noise, Scenario
from thorvaldc.runtime.manoeuvre import Segment
from thorvaldc.runtime.meter import Meter
from thorvaldc.runtime.scenario import ScenarioSimulation
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.simulation import Simulation

SECONDS = 77.0
RATE = 100.0  # Hz
ROUNDS = 7
# Forwards, sideways and turning mixed; every 7 s another motion, and a stop.
TWISTS = (
    (1.1, 0.0, 0.0),
    (1.0, 0.3, 0.15),
    (1.0, -0.4, -0.2),
    (0.9, 0.5, 0.0),
    (1.1, 0.1, 0.3),
    (1.0, 0.0, -0.35),
    (0.9, -0.5, 0.1),
    (1.1, 0.2, -0.1),
    (1.0, 0.4, 0.25),
    (1.1, -0.2, -0.3),
    (0.0, 0.0, 0.0),
)


def figures() -> Iterator[Figure]:
    robot, files = built(example("6wd6ws_asymmetric"))
    robot = replace(robot, driver=replace(robot.driver, rate=RATE))
    simulation = Simulation(robot, files)
    scene = simulation.scene
    if scene is None:
        raise SystemExit("there is no scene")
    starts = [7.0 * i for i in range(len(TWISTS))]
    plan = [Segment(start, Twist(*twist)) for start, twist in zip(starts, TWISTS, strict=True)]
    script = [Command(start, *twist) for start, twist in zip(starts, TWISTS, strict=True)]
    fleet = Fleet("mission", "", (Placement(robot.name, Pose(), robot),))
    commands = ((robot.name, tuple(script)),)
    scenario = ScenarioSimulation(
        Scenario("mission", "", fleet, SECONDS, commands, (), Noise(), (), robot.origin), files
    )
    controls: list[np.ndarray] = []

    def keep(_: Meter) -> None:
        controls.append(scene.data.ctrl.copy())

    run = simulation.run(SECONDS, plan, watch=keep).robots[0]
    end = scene.data.qpos.copy()
    steps = round(1.0 / RATE / scene.timestep)

    def floor() -> None:
        """The same controls and steps, and nothing else."""
        import mujoco

        scene.reset()
        model, data, step = scene.model, scene.data, mujoco.mj_step
        ctrl = data.ctrl
        for control in controls[:-1]:
            ctrl[:] = control
            step(model, data, steps)

    floor()
    if not np.array_equal(scene.data.qpos, end):
        raise SystemExit("the bare loop drives another way")
    whole, bare, played = least_times(
        [lambda: simulation.run(SECONDS, plan), floor, lambda: scenario.play(Report())], ROUNDS
    )
    yield Figure(
        "a mission of 77 s at 100 Hz",
        SECONDS / whole,
        "x real time",
        100,
        "higher",
        f"6WD6WS asymmetric, {run.path_true:.1f} m, driver, odometry and physics, least of"
        f" {ROUNDS}; {100 * bare / whole:.0f} % of it is mj_step, which alone makes"
        f" {SECONDS / bare:.0f}x ({1e6 * bare / len(controls) / steps:.1f} us a step);"
        f" ours {1e6 * (whole - bare) / len(controls):.0f} us a tick",
    )
    yield Figure(
        "the mission as a scenario",
        SECONDS / played,
        "x real time",
        None,
        "higher",
        "the same with slip, energy, contacts and limits measured and every number hashed",
    )
