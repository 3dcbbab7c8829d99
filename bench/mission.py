"""Computing time of the paper's mission, compared with real time and with the physics alone."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np

from bench.figure import ROOT, Figure, in_turns, is_compiled
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet
from thorvaldc.model.scenario import Scenario
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import ControlLoop, Segment
from thorvaldc.simulation.physics.drive_servos import DriveServos
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.simulation_run import Simulation

MISSION = ROOT / "examples" / "odometry_experiment" / "ideal.yaml"
RATE = 100.0  # Hz, of the driver
ROUNDS = 5


def figures() -> Iterator[Figure]:
    scenario = mission(RATE)
    files = emit(scenario.fleet, ["mjcf"])
    simulation = Simulation(scenario.fleet, files)
    scene = simulation.scene
    if scene is None:
        raise SystemExit("there is no scene")
    duration = scenario.duration
    plans = manoeuvres(scenario)
    controls: list[np.ndarray] = []

    def keep(_: ControlLoop) -> None:
        controls.append(scene.data.ctrl.copy())

    run = simulation.run(duration, plans, on_tick=keep).robots[0]
    end = scene.data.qpos.copy()
    steps = round(1.0 / RATE / scene.timestep)

    def floor() -> None:
        """Repeats the same controls and steps without driver and odometry."""
        scene.reset()
        model, data, step = scene.model, scene.data, mujoco.mj_step
        ctrl = data.ctrl
        servos = DriveServos(model, data)
        for control in controls[:-1]:
            ctrl[:] = control
            step(model, data, steps)
            servos.limit()

    floor()
    if not np.array_equal(scene.data.qpos, end):
        raise SystemExit("the bare loop ends at another position")
    scenario_simulation = ScenarioSimulation(scenario, files)
    times = in_turns(
        lambda: simulation.run(duration, plans),
        floor,
        lambda: scenario_simulation.play(Report()),
        rounds=ROUNDS,
    )
    whole, bare, measured = map(statistics.median, times)
    yield Figure(
        "a mission of 77 s at 100 Hz",
        duration / whole,
        "x real time",
        None,
        "higher",
        f"6WD6WS asymmetric, {run.path_true:.1f} m, driver, odometry and physics, median of"
        f" {ROUNDS}; {100 * bare / whole:.0f} % of it is mj_step, which alone runs at"
        f" {duration / bare:.0f}x ({1e6 * bare / len(controls) / steps:.1f} us per step);"
        f" the rest takes {1e6 * (whole - bare) / len(controls):.0f} us per tick",
    )
    yield Figure.ratio(
        "the mission beside bare physics",
        0.37 if is_compiled() else 0.27,
        zip(times[1], times[0], strict=True),
        "time of mj_step alone relative to the run; the control cycle is "
        + ("compiled" if is_compiled() else "interpreted"),
        better="higher",
    )
    yield Figure(
        "the mission as a scenario",
        duration / measured,
        "x real time",
        None,
        "higher",
        "the same run with metrics (slip, energy, contacts, limits) and the hash",
    )


def manoeuvres(scenario: Scenario) -> dict[str, list[Segment]]:
    """Returns the scenario's script by robot."""
    return {
        name: [Segment(c.time, Twist(c.vx, c.vy, c.wz)) for c in commands]
        for name, commands in scenario.commands
    }


def mission(rate: float) -> Scenario:
    """Returns the experiment with ideal sensors and the driver rate ``rate`` (Hz)."""
    scenario = compile_file(MISSION).scenario
    if scenario is None:
        raise SystemExit(f"{MISSION} does not compile")
    placements = tuple(
        replace(p, robot=replace(p.robot, driver=replace(p.robot.driver, rate=rate)))
        for p in scenario.fleet.placements
    )
    fleet: Fleet = replace(scenario.fleet, placements=placements)
    return replace(scenario, fleet=fleet)
