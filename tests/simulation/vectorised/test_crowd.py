"""Many robots of one kind: their odometry together is that of each by itself."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import Fleet, Placement, Pose
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.manoeuvre import Segment
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.simulation_run import Simulation, SimulationResult
from thorvaldc.simulation.vectorised import crowd
from thorvaldc.simulation.vectorised.odometry_batch import OdometryBatch

PLACES = [(0.6, 0.45), (0.5, -0.45), (0.1, 0.45), (0.0, -0.45), (-0.55, 0.45), (-0.55, -0.45)]
WHEELS = [wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate(PLACES)]
ROBOTS = 9
PLAN = [Segment(0.0, Twist(0.6, 0.1, 0.2)), Segment(1.0, Twist(0.5, -0.2, -0.3))]


def numbers(odometry: Odometry) -> list[float]:
    estimate = odometry.estimate
    found = [*odometry.pose, *estimate.twist, *estimate.chi_squares, float(estimate.rank)]
    for covariance in (odometry.covariance, estimate.covariance):
        found += [value for row in covariance for value in row]
    return found


def odometries(noise: Noise) -> list[Odometry]:
    geometry = BaseGeometry.from_wheels(WHEELS)
    return [Odometry(General(geometry, noise=noise), (1.5, 1.0)) for _ in range(ROBOTS)]


def way(seed: int, ticks: int) -> list[JointStates]:
    """Joints of a robot that drives, each with errors of its own; one of them is stuck once."""
    chance = random.Random(seed)
    calculator = General(BaseGeometry.from_wheels(WHEELS))
    found, turned = [], [0.0] * len(WHEELS)
    for k in range(ticks):
        twist = Twist(0.6 + 0.1 * math.sin(k / 9 + seed), 0.1 * math.sin(k / 7), 0.3)
        joints = calculator.command(twist).joints
        stuck = 2 if seed == 3 and 20 < k < 30 else None
        for i, speed in enumerate(joints.speeds):
            turned[i] += 0.0 if i == stuck else speed * chance.gauss(1.0, 0.005) * 0.02
        angles = [angle + chance.gauss(0.0, 0.002) for angle in joints.angles]
        found.append(
            JointStates(0.02 * k, joints.speeds, angles, [0.0] * len(WHEELS), tuple(turned))
        )
    return found


@pytest.mark.parametrize("noise", [Noise(), Noise(correlation=0.3)])
def test_together_is_each_by_itself(noise: Noise) -> None:
    together, alone = odometries(noise), odometries(noise)
    batch = OdometryBatch(together[0].calculator, together)
    ways = [way(seed, 60) for seed in range(ROBOTS)]
    dropped = 0
    for k in range(60):
        now = 0.02 * k
        joints = [states[k] for states in ways]
        if k == 40:  # what changes an odometry between two ticks holds
            for one in (*together[4:5], *alone[4:5]):
                one.reset(Pose2(3.0, -1.0, 2.0))
        batch.update(joints, now)
        taken = [one.joints is states for one, states in zip(together, joints, strict=True)]
        assert all(taken) == (k > 0)
        for one, other, states in zip(together, alone, joints, strict=True):
            one.update(states, now)  # as the driver's tick does; nothing is left to do
            other.update(states, now)
            assert numbers(one) == pytest.approx(numbers(other), rel=1e-9, abs=1e-13)
            assert one.estimate.dropped == other.estimate.dropped
            dropped += bool(one.estimate.dropped)
    assert dropped


def test_what_is_unusual_is_left_to_each() -> None:
    together = odometries(Noise())
    batch = OdometryBatch(together[0].calculator, together)
    ways = [way(seed, 3) for seed in range(ROBOTS)]
    for one, states in zip(together, ways, strict=True):
        one.update(states[0], 0.0)
    good = ways[0][1]
    late, nan = 5.0, math.nan
    unusual = [
        good,
        replace(good, positions=None),
        replace(good, yaw_rate=0.1),
        replace(good, time=late),
        replace(good, time=0.0),
        replace(good, speeds=[nan] * 6),
        replace(good, positions=[math.inf] * 6),
        replace(good, angles=[0.0] * 5),
        replace(good, positions=[1e300] * 6),
    ]
    before = [numbers(one) for one in together]
    batch.update(unusual, 0.02)
    assert [one.joints is states for one, states in zip(together, unusual, strict=True)] == [
        k == 0 for k in range(ROBOTS)
    ]
    assert [numbers(one) for one in together[1:]] == before[1:]
    batch.update([good] * ROBOTS, 0.02)  # all are back but the first, which has had it
    assert all(one.joints is good for one in together)


ROBOT = make_robot(FOUR_STEERED)


def drive(robots: int, least: int, monkeypatch: pytest.MonkeyPatch) -> SimulationResult:
    monkeypatch.setattr(crowd, "LEAST", least)
    placements = tuple(
        Placement(f"r{k}", Pose((3.0 * k, 0.0, 0.0)), replace(ROBOT, namespace=f"r{k}"))
        for k in range(robots)
    )
    return Simulation(Fleet("many", "", placements)).run(2.0, PLAN)


def test_a_fleet_drives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    updates = []
    update = OdometryBatch.update

    def counted(self: OdometryBatch, joints: list[JointStates], now: float) -> None:
        updates.append(len(joints))
        update(self, joints, now)

    monkeypatch.setattr(OdometryBatch, "update", counted)
    alone = drive(5, 100, monkeypatch)
    assert not updates
    together = drive(5, 5, monkeypatch)
    assert len(updates) == 100  # ticks after the first
    for one, other in zip(together.robots, alone.robots, strict=True):
        assert one.pose_odometry == pytest.approx(other.pose_odometry, abs=1e-12)
        assert one.path_commanded == other.path_commanded


def test_who_changes_parameters_is_of_the_kind_no_more() -> None:
    drivers = [BaseDriver(ROBOT, SimBase(ROBOT)) for _ in range(crowd.LEAST)]
    found = crowd.Crowd(drivers)
    everyone = range(len(drivers))
    for driver in drivers:
        driver.tick(0.0)
    assert list(found.sense(0.02, everyone)) == [*everyone]
    assert found.sense(0.02, everyone[1:]) == {}
    drivers[3].update(radii={ROBOT.wheels[0].name: 0.21})
    for driver in drivers:
        driver.tick(0.02)
    assert found.sense(0.04, everyone) == {}


def test_a_calculator_with_its_own_odometry_goes_by_itself() -> None:
    robot = make_robot(FOUR_STEERED, calculator="random_pairs")
    drivers = [BaseDriver(robot, SimBase(robot)) for _ in range(crowd.LEAST)]
    assert crowd.Crowd(drivers).sense(0.0, range(len(drivers))) == {}
