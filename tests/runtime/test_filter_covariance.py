"""A filter that sums the published twists has the right covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.filters import BOUNDED, DRIVE, MIXED, study
from tests.examples import example_robot
from tests.slow import mostly_exhaustive, mostly_slow
from thorvaldc.model.settings import FOR_FILTERS, MEASURED
from thorvaldc.runtime.base_interface import CheckedJointStates, JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.filter_covariance import filter_covariance
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import Twist

PERIOD = 0.02
WHITE = Noise(correlation=0.0, radius_error=0.0, steering_offset_error=0.0)
LASTING = Noise(correlation=2.0, radius_error=0.0, steering_offset_error=0.0)
DRIVE_LONG = Noise(correlation=0.0)


def covariances(noise: Noise, seconds: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the covariances of one twist, for filters, and of the errors of the drive, after some
    seconds of motion."""
    calculator = General(BaseGeometry.from_robot(example_robot("4wd4ws_wide")), None, noise)
    joints = JointStates(0.0, [5.0] * 4, [0.1, -0.1, 0.05, 0.0], [0.0] * 4)
    estimate = calculator.estimator.estimate(joints)
    published = filter_covariance(calculator.estimator, joints, estimate, PERIOD, seconds)
    errors = calculator.estimator.lasting_errors(joints, estimate, estimate.twist)
    drive = np.array(errors).reshape(-1, 3)
    return np.array(estimate.covariance), np.array(published), drive.T @ drive


def test_white_errors_are_published_as_they_are() -> None:
    single, published, _ = covariances(WHITE)
    assert published == pytest.approx(single)


def test_errors_that_last_seconds_count_as_their_sum() -> None:
    single, published, _ = covariances(LASTING)
    left = math.exp(-PERIOD / 2.0)
    errors = 50_000
    lags = np.arange(1, errors)
    variance_of_sum = errors + 2.0 * np.sum((errors - lags) * left**lags)
    assert published == pytest.approx(single * variance_of_sum / errors, rel=0.01)
    assert published == pytest.approx(single * 2.0 * 2.0 / PERIOD, rel=1e-4)


def test_errors_that_last_the_drive_count_by_the_time_of_a_filter() -> None:
    for seconds, counted in ((0.0, 0.0), (10.0, 10.0), (60.0, 60.0), (3600.0, 60.0)):
        single, published, drive = covariances(DRIVE_LONG, seconds)
        assert published == pytest.approx(single + 2.0 * 0.6 * counted / PERIOD * drive)
        assert np.linalg.eigvalsh(drive)[0] > 0.0


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_what_lasts_the_drive_does_not_count_as_lasting_seconds_too(share: float) -> None:
    errors = {"radius_error": share * 0.01, "steering_offset_error": share * math.radians(0.5)}
    single, published, _ = covariances(Noise(correlation=2.0, **errors))
    lasting = covariances(LASTING)[1]
    # At 1 m/s, 1 % is more than the 2 mm/s of a wheel at rest, which last seconds too.
    counted = (published - single) / (lasting - single)
    assert counted == pytest.approx(np.full((3, 3), 1.0 - share**2 / (1.0 + 0.23**2)), abs=0.01)


def test_errors_at_rest_last_seconds() -> None:
    calculator = General(BaseGeometry.from_robot(example_robot("4wd4ws_wide")))
    joints = JointStates(0.0, *[[0.0] * 4] * 3)
    estimate = calculator.odometry(joints)
    published = filter_covariance(calculator.estimator, joints, estimate, PERIOD, 60.0)
    assert published[0][0] == pytest.approx(200.0 * estimate.covariance[0][0], rel=1e-3)


def test_only_motion_counts_as_time_of_lasting_errors() -> None:
    odometry = Odometry(General(BaseGeometry.from_robot(example_robot("4wd4ws_wide"))), (1.0, 1.0))
    for k in range(301):
        speed = 5.0 if 100 <= k < 200 else 0.0
        odometry.update(CheckedJointStates(0.02 * k, [speed] * 4, [0.0] * 4, [0.0] * 4), 0.02 * k)
    assert odometry.motion_time == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("seconds", [2.0, 10.0, 60.0])
def test_a_filter_is_not_sure_while_nothing_decides(seconds: float) -> None:
    """A held robot with three spinning wheels of four."""
    calculator = General(BaseGeometry.from_robot(example_robot("4wd4ws_wide")))
    speeds = calculator.command(Twist(0.8, 0.0, 0.0)).joints.speeds
    joints = JointStates(0.0, [0.0, *speeds[1:]], [0.0] * 4, [0.0] * 4)
    estimate = calculator.odometry(joints)
    published = filter_covariance(calculator.estimator, joints, estimate, PERIOD, seconds)
    variance = published[0][0] * PERIOD * seconds  # N T^2 Q, of N = seconds / period twists
    assert estimate.twist.vx * seconds <= 3.0 * math.sqrt(variance)


def test_before_the_first_joint_states_the_covariance_is_that_of_the_estimate() -> None:
    calculator = General(BaseGeometry.from_robot(example_robot("4wd4ws_wide")))
    estimate = calculator.odometry(JointStates(0.0, [0.0] * 4, [0.0] * 4, [0.0] * 4))
    published = filter_covariance(calculator.estimator, None, estimate, PERIOD, 0.0)
    assert published == estimate.covariance


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [20.0, 60.0])
@pytest.mark.parametrize("drive", mostly_exhaustive(BOUNDED))
def test_the_filter_is_consistent_about_lasting_errors_at_all_times(
    drive: str, seconds: float
) -> None:
    robot = example_robot("4wd4ws_wide")
    result = study(robot, drive, DRIVE, rate=10.0, seconds=seconds)
    assert 0.5 < result.nees < 2.0
    assert 0.5 < result.default <= result.nees, "everything may last by default"


@pytest.mark.parametrize("drive", mostly_exhaustive(BOUNDED))
@pytest.mark.parametrize("kind", mostly_slow(["white", "lasting 2 s", MIXED], 0))
def test_the_filter_is_consistent_with_the_noise_of_the_errors(kind: str, drive: str) -> None:
    # White errors are as small as the error of the filter's Euler steps: they need short ones.
    rate, runs = (50.0, 50) if kind == "white" else (10.0, 200)
    result = study(example_robot("4wd4ws_wide"), drive, kind, rate=rate, runs=runs)
    assert 0.5 < result.nees < 2.0


@pytest.mark.slow
def test_with_the_covariance_of_one_twist_the_filter_is_wrong_and_sure() -> None:
    results = [
        study(example_robot("4wd4ws_wide"), "straight", DRIVE, covariance, rate=10.0, runs=50)
        for covariance in (MEASURED, FOR_FILTERS)
    ]
    wrong, right = results
    assert wrong.nees > 100.0 * right.nees
    assert wrong.sigma < wrong.distance / 10.0
    assert right.sigma == pytest.approx(right.distance, rel=0.5)
