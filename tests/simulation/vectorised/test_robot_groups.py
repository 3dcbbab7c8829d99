"""Batched odometry of equal robots gives the same results as the odometry of each robot."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import Fleet, Placement, Pose
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import PLUGINS, BaseGeometry, Noise, WheelGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation import simulation_run
from thorvaldc.simulation.control_loop import Segment, SimulationResult
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.simulation_run import Simulation
from thorvaldc.simulation.vectorised.calculator_batch import OdometryBatch

POSITIONS = [(0.6, 0.45), (0.5, -0.45), (0.1, 0.45), (0.0, -0.45), (-0.55, 0.45), (-0.55, -0.45)]
WHEELS = [wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate(POSITIONS)]
TRICYCLE = [
    wheel("front", 0.6, 0.1, "steered", heading=0.2, sign=-1.0, trail=-0.05, lateral=0.04),
    wheel("caster", 0.3, -0.3, "swivel"),
    wheel("left", -0.4, 0.45, "fixed", radius=0.25),
    wheel("right", -0.4, -0.35, "passive", radius=0.15),
]
"""Wheels of all kinds; few, so that the covariance of a wheel's residual has rank 1."""
BICYCLE = [TRICYCLE[2], TRICYCLE[0]]
ROBOTS = 9
PLAN = [Segment(0.0, Twist(0.6, 0.1, 0.2)), Segment(1.0, Twist(0.5, -0.2, -0.3))]


def numbers(odometry: Odometry) -> list[float]:
    estimate = odometry.estimate
    values = [*odometry.pose, *estimate.twist, *estimate.chi_squares, float(estimate.rank)]
    for covariance in (odometry.covariance, estimate.covariance):
        values += [value for row in covariance for value in row]
    return values


def odometries(noise: Noise, wheels: Sequence[WheelGeometry] = WHEELS) -> list[Odometry]:
    geometry = BaseGeometry.from_wheels(wheels)
    return [Odometry(General(geometry, noise=noise), (1.5, 1.0)) for _ in range(ROBOTS)]


def joint_log(seed: int, ticks: int, wheels: Sequence[WheelGeometry] = WHEELS) -> list[JointStates]:
    """Joint states of a moving robot with random errors; with seed 3 a wheel sticks."""
    rng = random.Random(seed)
    calculator = General(BaseGeometry.from_wheels(wheels))
    log, positions = [], [0.0] * len(wheels)
    for k in range(ticks):
        twist = Twist(0.6 + 0.1 * math.sin(k / 9 + seed), 0.1 * math.sin(k / 7), 0.3)
        joints = calculator.command(twist).joints
        stuck = 2 if seed == 3 and 20 < k < 30 else None
        for i, speed in enumerate(joints.speeds):
            positions[i] += 0.0 if i == stuck else speed * rng.gauss(1.0, 0.005) * 0.02
        angles = [angle + rng.gauss(0.0, 0.002) for angle in joints.angles]
        rates = [
            (a - b) / 0.02 for a, b in zip(angles, log[-1].angles if log else angles, strict=True)
        ]
        log.append(JointStates(0.02 * k, joints.speeds, angles, rates, tuple(positions)))
    return log


@pytest.mark.parametrize(
    ("wheels", "noise"),
    [
        (WHEELS, Noise()),
        (WHEELS, Noise(correlation=0.3)),
        (TRICYCLE, Noise()),
        (BICYCLE, Noise()),
    ],
    ids=["six", "correlated", "tricycle", "bicycle"],
)
def test_batch_equals_single_odometries(wheels: Sequence[WheelGeometry], noise: Noise) -> None:
    batched, single = odometries(noise, wheels), odometries(noise, wheels)
    batch = OdometryBatch(batched[0].calculator, batched)
    logs = [joint_log(seed, 60, wheels) for seed in range(ROBOTS)]
    dropped = 0
    for k in range(60):
        now = 0.02 * k
        joints = [log[k] for log in logs]
        if k == 40:  # the batch notices a reset between two ticks
            for odometry in (batched[4], single[4]):
                odometry.reset(Pose2(3.0, -1.0, 2.0))
        batch.update(joints, now)
        updated = [o.joints is states for o, states in zip(batched, joints, strict=True)]
        assert all(updated) == (k > 0)
        for in_batch, alone, states in zip(batched, single, joints, strict=True):
            in_batch.update(states, now)  # the driver's tick calls it too; it has no effect
            alone.update(states, now)
            assert numbers(in_batch) == pytest.approx(numbers(alone), rel=1e-9, abs=1e-13)
            assert in_batch.estimate.dropped == alone.estimate.dropped
            dropped += bool(in_batch.estimate.dropped)
    assert dropped or wheels is BICYCLE


def test_batch_leaves_out_unusual_joint_states() -> None:
    batched = odometries(Noise())
    batch = OdometryBatch(batched[0].calculator, batched)
    logs = [joint_log(seed, 3) for seed in range(ROBOTS)]
    for odometry, log in zip(batched, logs, strict=True):
        odometry.update(log[0], 0.0)
    good = logs[0][1]
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
    before = [numbers(odometry) for odometry in batched]
    batch.update(unusual, 0.02)
    updated = [o.joints is states for o, states in zip(batched, unusual, strict=True)]
    assert updated == [k == 0 for k in range(ROBOTS)]
    assert [numbers(odometry) for odometry in batched[1:]] == before[1:]
    batch.update([good] * ROBOTS, 0.02)  # the first robot has these joint states already
    assert all(odometry.joints is good for odometry in batched)


ROBOT = make_robot(FOUR_STEERED)


def drive(robots: int, min_group: int, monkeypatch: pytest.MonkeyPatch) -> SimulationResult:
    monkeypatch.setattr(simulation_run, "MIN_GROUP_SIZE", min_group)
    placements = tuple(
        Placement(f"r{k}", Pose((3.0 * k, 0.0, 0.0)), replace(ROBOT, namespace=f"r{k}"))
        for k in range(robots)
    )
    return Simulation(Fleet("many", "", placements)).run(2.0, PLAN)


def test_fleet_drives_the_same_with_and_without_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    updates = []
    update = OdometryBatch.update

    def counted(self: OdometryBatch, joints: list[JointStates], now: float) -> None:
        updates.append(len(joints))
        update(self, joints, now)

    monkeypatch.setattr(OdometryBatch, "update", counted)
    single = drive(5, 100, monkeypatch)
    assert not updates
    batched = drive(5, 5, monkeypatch)
    assert len(updates) == 100  # ticks after the first
    for in_batch, alone in zip(batched.robots, single.robots, strict=True):
        assert in_batch.pose_odometry == pytest.approx(alone.pose_odometry, abs=1e-12)
        assert in_batch.path_commanded == alone.path_commanded


def test_parameter_change_ends_the_group() -> None:
    drivers = [BaseDriver(ROBOT, SimBase(ROBOT)) for _ in range(simulation_run.MIN_GROUP_SIZE)]
    groups = simulation_run.RobotGroups(drivers)
    robots = range(len(drivers))
    for driver in drivers:
        driver.tick(0.0)
    assert list(groups.update_odometry(0.02, robots)) == [*robots]
    assert groups.update_odometry(0.02, robots[1:]) == {}
    drivers[3].update(radii={ROBOT.wheels[0].name: 0.21})
    for driver in drivers:
        driver.tick(0.02)
    assert groups.update_odometry(0.04, robots) == {}


def test_calculator_with_its_own_odometry_has_no_group(monkeypatch: pytest.MonkeyPatch) -> None:
    own = "bench.random_pairs.random_pairs_calculator:RandomPairs"
    monkeypatch.setitem(PLUGINS.builtin, "random_pairs", own)
    robot = make_robot(FOUR_STEERED, calculator="random_pairs")
    drivers = [BaseDriver(robot, SimBase(robot)) for _ in range(simulation_run.MIN_GROUP_SIZE)]
    groups = simulation_run.RobotGroups(drivers)
    assert groups.update_odometry(0.0, range(len(drivers))) == {}
