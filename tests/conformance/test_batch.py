"""Batches equal the scalar calculators to 1e-12, for random robots."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.conformance.test_calculators import (
    SETTINGS,
    any_wheels,
    axle_wheels,
    make,
    tricycle_wheels,
)
from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates, NotFiniteError
from thorvaldc.runtime.calculators import BaseCalculator, BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.general import General, GeneralOptions
from thorvaldc.runtime.calculators.twist_estimator import (
    EstimatorOptions,
    TwistEstimate,
    TwistEstimator,
)
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.vectorised.calculator_batch import Array, CalculatorBatch

N = 24
TOLERANCE = 1e-12


def random_joints(
    seed: int, wheels: list[WheelGeometry], calculator: BaseCalculator
) -> list[Array]:
    """Random speeds, angles and rates; half of them near a consistent motion."""
    rng = np.random.default_rng(seed)
    n = len(wheels)
    speeds, angles = rng.uniform(-8.0, 8.0, (n, N)), rng.uniform(-3.0, 3.0, (n, N))
    rates = rng.uniform(-2.0, 2.0, (n, N))
    for k in range(N // 2):
        command = calculator.command(Twist(*rng.uniform(-1.0, 1.0, 3)))
        speeds[:, k] = np.array(command.joints.speeds) * (1.0 + 0.02 * rng.normal(size=n))
        angles[:, k] = np.array(command.joints.angles) + 0.01 * rng.normal(size=n)
        rates[:, k] = 0.0
    speeds[:, 0] = angles[:, 0] = rates[:, 0] = 0.0
    return [speeds, angles, rates]


def state(arrays: list[Array], k: int, yaw_rates: Array | None = None) -> JointStates:
    speeds, angles, rates = ([float(v) for v in a[:, k]] for a in arrays)
    return JointStates(
        0.0, speeds, angles, rates, None, None if yaw_rates is None else float(yaw_rates[k])
    )


def near(values: Array, expected: Array) -> None:
    """Compares to 1e-12 of the largest scalar value, or of 1."""
    scale = np.maximum(1.0, np.abs(expected).max(axis=0, initial=0.0))
    assert np.all(np.abs(values - expected) <= TOLERANCE * scale)


def same(scalar: TwistEstimate, twist: Array, covariance: Array, tests: Array) -> None:
    # What is hardly known has as many digits less.
    (a, b, c), (_, d, e), (_, _, f) = scalar.covariance
    bound = TOLERANCE * max(1.0, math.sqrt(max(a, d, f)) / 1e-2)
    scale = max(1.0, *(abs(v) for v in scalar.twist))
    assert np.all(np.abs(twist - np.array(scalar.twist)) <= bound * scale)
    assert np.all(np.abs(covariance - np.array([a, b, c, d, e, f])) <= bound * max(a, d, f))
    expected = np.array(scalar.chi_squares)
    assert np.all(np.abs(tests - expected) <= 1e-9 * np.maximum(1.0, expected))


@SETTINGS
@given(
    wheels=st.one_of(any_wheels(), axle_wheels(), tricycle_wheels()),
    seed=st.integers(0, 10**6),
    gyro=st.booleans(),
    polish=st.integers(0, 2),
)
def test_estimates_are_those_of_the_estimator(
    wheels: list[WheelGeometry], seed: int, gyro: bool, polish: int
) -> None:
    calculator = make("general", wheels)
    geometry = calculator.geometry
    joints = random_joints(seed, wheels, calculator)
    yaw_rates = np.random.default_rng(seed).uniform(-1.0, 1.0, N) if gyro else None
    speeds, angles, rates = joints
    twists, covariances = np.empty((3, N)), np.empty((6, N))
    tests = np.empty((len(wheels), N))
    for faulty in (0, 2):
        estimator = TwistEstimator(geometry, None, EstimatorOptions(faulty=faulty, polish=polish))
        calculator.estimator = estimator
        dropped = CalculatorBatch(calculator).estimate(
            speeds, angles, twists, covariances, tests, rates, yaw_rates
        )
        for k in range(N):
            scalar = estimator.estimate(state(joints, k, yaw_rates))
            same(scalar, twists[:, k], covariances[:, k], tests[:, k])
            assert dropped.get(k, ()) == scalar.dropped


@SETTINGS
@given(
    wheels=st.one_of(any_wheels(), axle_wheels(), tricycle_wheels()),
    seed=st.integers(0, 10**6),
    polish=st.integers(0, 1),
)
def test_exact_estimates_are_those_of_the_estimator_to_the_last_bit(
    wheels: list[WheelGeometry], seed: int, polish: int
) -> None:
    calculator = make("general", wheels)
    estimator = TwistEstimator(calculator.geometry, None, EstimatorOptions(polish=polish))
    calculator.estimator = estimator
    joints = random_joints(seed, wheels, calculator)
    speeds, angles, rates = joints
    twists = np.empty((3, N))
    batch = CalculatorBatch(calculator, as_scalar=True)
    dropped = batch.estimate(speeds, angles, twists, rates=rates)
    for k in range(N):
        scalar = estimator.estimate(state(joints, k))
        assert tuple(twists[:, k].tolist()) == scalar.twist
        assert dropped.get(k, ()) == scalar.dropped


@SETTINGS
@given(wheels=st.one_of(any_wheels(), axle_wheels(), tricycle_wheels()), seed=st.integers(0, 10**6))
@example(wheels=[wheel("w0", 0, 0, "steered", lateral=0.12, radius=0.1)], seed=0)  # rank 2
def test_batch_compares_wheels_with_their_commands(wheels: list[WheelGeometry], seed: int) -> None:
    """In some columns the commands are unknown, and in some an encoder is dead or late."""
    calculator = make("general", wheels)
    joints = random_joints(seed, wheels, calculator)
    speeds, angles, rates = joints
    factors = np.random.default_rng(seed).choice([-1.0, 0.9, 1.0, 1.0, 1.02], speeds.shape)
    commands = [None if k % 5 == 0 else (speeds * factors)[:, k].tolist() for k in range(N)]
    twists, covariances = np.empty((3, N)), np.empty((6, N))
    tests, suspects = np.empty((len(wheels), N)), dict[int, tuple[int, ...]]()
    dropped = CalculatorBatch(calculator).estimate(
        speeds,
        angles,
        twists,
        covariances,
        tests,
        rates,
        commanded=commands.__getitem__,
        suspects=suspects,
    )
    for k in range(N):
        scalar = calculator.estimator.estimate(state(joints, k), commands[k])
        same(scalar, twists[:, k], covariances[:, k], tests[:, k])
        assert dropped.get(k, ()) == scalar.dropped
        assert suspects.get(k, ()) == scalar.suspects


FOUR = [
    wheel(f"w{i}", x, y, "steered")
    for i, (x, y) in enumerate([(0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4)])
]


def batch(faulty_wheels: int = 2) -> CalculatorBatch:
    options = GeneralOptions(faulty_wheels=faulty_wheels)
    return CalculatorBatch(General(BaseGeometry.from_wheels(FOUR), options))


def followed(twists: Array) -> tuple[Array, Array]:
    """Returns the speeds and angles of wheels that follow the twists."""
    velocities = np.array(
        [(twists[0] - twists[2] * w.y, twists[1] + twists[2] * w.x) for w in FOUR]
    )
    radii = np.array([[w.radius] for w in FOUR])
    return np.hypot(velocities[:, 0], velocities[:, 1]) / radii, np.arctan2(
        velocities[:, 1], velocities[:, 0]
    )


def test_pieces_join() -> None:
    """More states than one piece holds, and none at all."""
    n = 20000
    twists = np.random.default_rng(1).uniform(-0.5, 0.5, (3, n))
    back = np.full((3, n), np.nan)
    batch(faulty_wheels=0).estimate(*followed(twists), back)
    assert (np.abs(back - twists).max(axis=0) < 1e-9).all()
    empty = np.empty((4, 0))
    assert batch().estimate(empty, empty, np.empty((3, 0))) == {}


def test_the_wheels_left_out_are_told_by_state() -> None:
    twists = np.zeros((3, 5))
    twists[0] = 0.5
    speeds, angles = followed(twists)
    speeds[2, 3] *= 1.5
    assert batch().estimate(speeds, angles, twists) == {3: (2,)}
    assert twists[0] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_bad_numbers_write_nothing(bad: float) -> None:
    twists, speeds, angles = np.full((3, 5), 7.0), np.full((4, 5), 7.0), np.full((4, 5), 7.0)
    angles[1, 2] = bad
    with pytest.raises(NotFiniteError):
        batch().estimate(speeds, angles, twists)
    with pytest.raises(NotFiniteError):
        batch().estimate(speeds, speeds, twists, yaw_rates=np.full(5, bad))
    assert (twists == 7.0).all()


def test_arrays_of_other_shapes_are_refused() -> None:
    twists, joints = np.zeros((3, 5)), np.zeros((4, 5))
    wrong: list[Any] = [np.zeros((4, 6)), np.zeros((3, 5)), np.zeros(5), joints.astype(np.float32)]
    for bad in wrong:
        with pytest.raises(ValueError, match=r"expected float64 \(4, 5\)"):
            batch().estimate(joints, bad, twists)
        with pytest.raises(ValueError, match=r"expected float64 \(4, 5\)"):
            batch().estimate(bad, joints, twists)
    with pytest.raises(ValueError, match=r"expected float64 \(6, 5\)"):
        batch().estimate(joints, joints, twists, covariances=twists)
