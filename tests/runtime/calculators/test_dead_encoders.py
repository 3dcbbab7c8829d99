"""Two dead encoders of four, or two wheels that spin on a robot that is held: nothing decides."""

from __future__ import annotations

import math
import random
from collections import Counter

import numpy as np
import pytest

from tests.runtime.calculators.test_wheel_causes import FOUR, MOTIONS, joints
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.se2 import Twist

RUNS = 60


def dead(states: JointStates, *wheels: int) -> JointStates:
    speeds = [0.0 if i in wheels else v for i, v in enumerate(states.speeds)]
    return JointStates(0.0, speeds, states.angles, states.angle_rates)


def verdict(estimate: TwistEstimate, faulty: set[int]) -> str:
    dropped = set(estimate.dropped)
    if not dropped:
        return "none"
    return "right" if dropped == faulty else "wrong"


def nees(estimate: TwistEstimate, true: Twist) -> float:
    error = np.array(estimate.twist) - np.array(true)
    return float(error @ np.linalg.solve(np.array(estimate.covariance), error)) / 3.0


@pytest.mark.parametrize("commanded", [False, True], ids=["no commands", "commands"])
@pytest.mark.parametrize("motion", MOTIONS[:3], ids=str)
def test_good_wheels_are_not_named(motion: Twist, commanded: bool) -> None:
    rng = random.Random(6)
    estimator = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    verdicts: Counter[str] = Counter()
    errors = []
    for seed in range(RUNS):
        healthy = joints(FOUR, motion, Noise(), seed)
        faulty = rng.sample(range(4), 2)
        commands = joints(FOUR, motion).speeds if commanded else None
        estimate = estimator.estimate(dead(healthy, *faulty), commands)
        verdicts[verdict(estimate, set(faulty))] += 1
        errors.append(nees(estimate, motion))
    assert verdicts == {"none": RUNS}
    assert np.median(errors) <= 2.0
    assert max(errors) <= 16.27 / 3.0


def test_without_commands_the_covariance_contains_both_cases() -> None:
    """Two wheels show 0.8 m/s, and two show 0 m/s."""
    estimator = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    estimate = estimator.estimate(dead(joints(FOUR, Twist(0.8, 0.0, 0.0)), 0, 1))
    assert estimate.dropped == ()
    sigma = math.sqrt(estimate.covariance[0][0])
    assert estimate.twist.vx <= 2.0 * sigma
    assert 0.8 - estimate.twist.vx <= 2.0 * sigma


def test_calculator_uses_its_last_command() -> None:
    motion = Twist(0.8, 0.0, 0.0)
    calculator = General(BaseGeometry.from_wheels(FOUR))
    calculator.command(motion)
    states = dead(joints(FOUR, motion), 0, 1)
    estimate = calculator.odometry(states)
    assert (estimate.dropped, estimate.sliding) == ((), (2, 3))
    assert {0, 1} <= set(estimate.suspects)
    # A robot that was not commanded to move is pushed, or two of its encoders are wrong.
    calculator.command(Twist(0.0, 0.0, 0.0))
    estimate = calculator.odometry(states)
    assert estimate.dropped == ()
    assert {2, 3} <= set(estimate.suspects)


def test_wheels_that_all_stand_measure_a_robot_that_stands() -> None:
    """All drives are late, or stall: no wheel disagrees, so the commands hardly count."""
    estimator = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    commands = joints(FOUR, Twist(0.8, 0.0, 0.0)).speeds
    estimate = estimator.estimate(dead(joints(FOUR, Twist(0.8, 0.0, 0.0)), 0, 1, 2, 3), commands)
    assert estimate.dropped == ()
    assert estimate.twist == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
