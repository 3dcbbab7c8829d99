"""Metrics equal sums over the ticks of a run, computed here one tick after the other."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest

from tests.backends.plans import ROBOTS
from tests.simulation.test_scenario_run import HEAD, simulation
from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics import Report
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.simulation import scenario_metrics
from thorvaldc.simulation.control_loop import ControlLoop
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.scenario_run import ScenarioSimulation

LIMIT_TOLERANCE = math.radians(0.2)
SCRIPT = """script:
  - {at: 0, vx: 0.5 m/s, wz: 1.5 rad/s}
  - {at: 1.5, vx: 0.5 m/s, wz: -1.5 rad/s}
  - {at: 3, vx: 0.5 m/s}
"""


class Sums:
    """Energy, slips and arrivals at steering limits of a robot."""

    def __init__(self) -> None:
        self.time = self.energy = 0.0
        self.squares: list[float] = []
        self.hits = 0
        self.at_limit: set[int] = set()

    def add(self, loop: ControlLoop) -> None:
        sample, base = loop.sample(), loop.base
        assert isinstance(base, MujocoBase)
        joints = sample.joints
        assert joints is not None
        data, dt = base.scene.data, sample.time - self.time
        self.time = sample.time
        power = data.actuator_force * data.actuator_velocity
        self.energy += dt * math.fsum(p for p in power.tolist() if p > 0.0)
        vx, vy, wz = sample.true
        at_limit = set()
        for i, wheel in enumerate(BaseGeometry.from_robot(loop.robot).wheels):
            angle, rate = joints.angles[i], joints.angle_rates[i] * wheel.sign
            direction = wheel.heading + wheel.sign * angle
            c, s = math.cos(direction), math.sin(direction)
            ux, uy = vx - wz * wheel.y, vy + wz * wheel.x
            if wheel.driven and not wheel.swivel:
                along = c * ux + s * uy - wheel.lateral * (wz + rate)
                across = c * uy - s * ux + wheel.trail * (wz + rate)
                self.squares.append((along - wheel.radius * joints.speeds[i]) ** 2 + across**2)
            limits = (wheel.lower, wheel.upper)
            if wheel.steered and any(
                x is not None and abs(angle - x) < LIMIT_TOLERANCE for x in limits
            ):
                at_limit.add(i)
        self.hits += len(at_limit - self.at_limit)
        self.at_limit = at_limit


def drive_of(folder: Path, name: str) -> ScenarioSimulation:
    """Returns a scenario with a robot of the examples, or of the plans of the backends."""
    text = HEAD.split("script")[0] + SCRIPT
    if name not in ROBOTS:
        return simulation(folder, text.replace("4wd4ws_slim", name))
    scenario = simulation(folder, text).scenario
    (placement,) = scenario.fleet.placements
    robot = dataclasses.replace(ROBOTS[name], namespace=placement.robot.namespace)
    placement = dataclasses.replace(placement, robot=robot)
    fleet = dataclasses.replace(scenario.fleet, placements=(placement,))
    files = emit(fleet, ["mjcf"], Report())
    return ScenarioSimulation(dataclasses.replace(scenario, fleet=fleet), files)


@pytest.mark.parametrize(
    ("robot", "hits"), [("car", 2), ("6wd6ws_asymmetric", 0), ("turned_home", None)]
)
def test_metrics_are_sums_over_the_ticks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, robot: str, hits: int | None
) -> None:
    drive, sums = drive_of(tmp_path, robot), Sums()
    (metrics,) = drive.play(Report(), on_tick=sums.add).metrics.values()
    assert metrics["energy"] == pytest.approx(sums.energy, rel=1e-12)
    mean_square = math.fsum(sums.squares) / len(sums.squares)
    assert metrics["slip"] == pytest.approx(math.sqrt(mean_square), rel=1e-9)
    assert metrics["largest_slip"] == pytest.approx(math.sqrt(max(sums.squares)), rel=1e-9)
    assert metrics["steering_limit_hits"] == sums.hits
    assert hits is None or sums.hits == hits
    for ticks in (1, 7):
        monkeypatch.setattr(scenario_metrics, "_MOST_TICKS", ticks)
        assert drive.play(Report()).metrics == {"cart": metrics}
