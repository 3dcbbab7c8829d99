"""Odometry: the pose, the growth of its covariance, and invalid joint states."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates, NotFiniteError
from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimator
from thorvaldc.runtime.odometry import LONGEST_INTERVAL, Odometry
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, Pose2, Twist

PLACES = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]
WHEELS = [wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate(PLACES)]
FASTEST = (1.5, 1.0)


def make_odometry(noise: Noise | None = None) -> Odometry:
    calculator = General(BaseGeometry.from_wheels(WHEELS))
    if noise is not None:
        calculator.estimator = TwistEstimator(calculator.geometry, noise)
    return Odometry(calculator, FASTEST)


def joints(odometry: Odometry, twist: Twist, time: float) -> JointStates:
    command = odometry.calculator.command(twist)
    return JointStates(time, command.joints.speeds, command.joints.angles, [0.0] * 4)


def driven(odometry: Odometry, twist: Twist, start: float, end: float, dt: float = 0.02) -> float:
    """Drives, updates the odometry, and returns the time of the last update."""
    steps = round((end - start) / dt)
    for k in range(steps + 1):
        odometry.update(joints(odometry, twist, start + k * dt), start + k * dt)
    return start + steps * dt


def size(covariance: se2.Cov3) -> float:
    return covariance[0][0] + covariance[1][1]


def test_constant_twists_are_integrated_exactly() -> None:
    odometry = make_odometry()
    driven(odometry, Twist(0.5, 0.2, 0.4), 0.0, 10.0)
    assert odometry.pose == pytest.approx(se2.exp(Twist(0.5, 0.2, 0.4), 10.0), abs=1e-9)
    assert 0.0 < size(odometry.covariance) < 0.01


def test_gap_keeps_the_pose_and_increases_its_covariance() -> None:
    odometry = make_odometry()
    now = driven(odometry, Twist(0.5, 0.0, 0.1), 0.0, 2.0)
    pose, before = odometry.pose, odometry.covariance
    odometry.update(joints(odometry, Twist(0.5, 0.0, 0.1), now + 4.0), now + 4.0)
    assert odometry.pose == pose
    assert odometry.covariance[0][0] >= before[0][0] + (1.5 * 4.0) ** 2
    assert odometry.covariance[2][2] >= before[2][2] + 4.0**2
    driven(odometry, Twist(0.5, 0.0, 0.1), now + 4.02, now + 6.0)
    assert odometry.pose != pose
    assert odometry.estimate.twist == pytest.approx((0.5, 0.0, 0.1))


def test_decreasing_time_is_a_gap() -> None:
    odometry = make_odometry()
    now = driven(odometry, Twist(0.5, 0.0, 0.1), 0.0, 2.0)
    pose, before = odometry.pose, size(odometry.covariance)
    odometry.update(joints(odometry, Twist(0.5, 0.0, 0.1), -7.0), now + 0.02)
    assert odometry.pose == pose
    assert size(odometry.covariance) == pytest.approx(before + 2 * (1.5 * 0.02) ** 2)
    odometry.update(joints(odometry, Twist(0.5, 0.0, 0.1), -6.98), now + 0.04)
    assert odometry.pose.relative_to(pose) == pytest.approx(
        se2.exp(Twist(0.5, 0.0, 0.1), 0.02), abs=1e-9
    )


@pytest.mark.parametrize("lost", [3, 40])
@pytest.mark.parametrize("how", ["missing", "stale", "nan", "nan at the same time", "short"])
def test_covariance_grows_while_joint_states_are_missing(how: str, lost: int) -> None:
    odometry = make_odometry()
    twist = Twist(0.5, 0.0, 0.1)
    now = driven(odometry, twist, 0.0, 2.0)
    pose, estimate, before = odometry.pose, odometry.estimate, size(odometry.covariance)
    last = odometry.joints
    assert last is not None
    sizes = [before]
    for _ in range(lost):
        now += 0.02
        if how == "missing":
            odometry.mark_missing(now)
        elif how == "stale":
            odometry.update(last, now)
        elif how == "nan at the same time":
            with pytest.raises(NotFiniteError, match="steering angle of wheel w2"):
                odometry.update(replace(last, angles=[0.0, 0.0, math.nan, 0.0]), now)
            odometry.mark_missing(now)
        elif how == "nan":
            with pytest.raises(NotFiniteError, match="speed of wheel w1"):
                odometry.update(replace(last, time=now, speeds=[0.0, math.nan, 0.0, 0.0]), now)
            odometry.mark_missing(now)
        else:
            with pytest.raises(ValueError, match="3 wheels for 4"):
                odometry.update(replace(last, time=now, speeds=[0.0] * 3), now)
            odometry.mark_missing(now)
        assert odometry.pose == pose
        assert odometry.estimate is estimate
        sizes.append(size(odometry.covariance))
    assert sizes == sorted(set(sizes))
    odometry.update(joints(odometry, twist, now + 0.02), now + 0.02)
    if (lost + 1) * 0.02 <= LONGEST_INTERVAL:  # the wheel positions contain the motion in between
        step = se2.exp(twist, (lost + 1) * 0.02)
        assert odometry.pose.relative_to(pose) == pytest.approx(step, abs=1e-9)
        assert size(odometry.covariance) < sizes[1]
    else:
        assert odometry.pose == pose
        assert size(odometry.covariance) >= sizes[-1]


def test_reset_sets_the_pose() -> None:
    odometry = make_odometry()
    driven(odometry, Twist(0.5, 0.0, 0.0), 0.0, 2.0)
    odometry.reset(Pose2(5.0, 1.0, math.pi / 2))
    assert odometry.covariance == ZERO_COV
    driven(odometry, Twist(0.5, 0.0, 0.0), 2.02, 4.0)
    assert odometry.pose == pytest.approx((5.0, 2.0, math.pi / 2), abs=1e-9)


def test_positions_are_more_accurate_than_speeds() -> None:
    """The speed is higher between the ticks than at the ticks."""
    odometry = make_odometry()
    zeros = [0.0] * 4
    for k in range(11):
        positions = [0.1 * k] * 4
        odometry.update(JointStates(0.1 * k, zeros, zeros, zeros, positions), 0.1 * k)
    assert odometry.pose == pytest.approx((0.2, 0.0, 0.0))


def test_unmeasured_rotation_does_not_average_out() -> None:
    """One wheel and casters do not measure a rotation about the wheel, which may be constant."""
    wheels = [wheel("d", 0.5, 0.0, "steered"), wheel("c", -0.5, 0.3, "swivel")]
    odometry = Odometry(General(BaseGeometry.from_wheels(wheels)), FASTEST)
    zeros = [0.0] * 2
    for k in range(501):
        odometry.update(JointStates(0.02 * k, zeros, zeros, zeros), 0.02 * k)
    # The unmeasured rotation may have been constant for 10 s.
    assert math.sqrt(odometry.covariance[2][2]) >= 10.0 * math.sqrt(
        odometry.estimate.covariance[2][2]
    )


@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_pose_errors_agree_with_the_covariance(correlation: float) -> None:
    """NEES / 3 of the pose is near 1, for independent and for correlated errors."""
    rng = random.Random(8)
    noise = Noise(correlation=correlation, radius_error=0.0, steering_offset_error=0.0)
    dt, steps, runs = 0.02, 300, 25
    left = math.exp(-dt / correlation) if correlation else 0.0
    total = 0.0
    for _ in range(runs):
        odometry = make_odometry(noise)
        true, last = ORIGIN, Twist(0.0, 0.0, 0.0)
        errors = [[rng.gauss(0.0, 1.0) for _ in range(8)]]
        for _ in range(steps):
            old = errors[-1]
            fresh = math.sqrt(1.0 - left * left)
            errors.append([left * e + fresh * rng.gauss(0.0, 1.0) for e in old])
        phase = rng.uniform(0.0, 6.0)
        for k in range(steps + 1):
            twist = Twist(0.8, 0.3 * math.sin(0.01 * k + phase), 0.4 * math.cos(0.013 * k + phase))
            command = odometry.calculator.command(twist).joints
            e = errors[k]
            speeds = [v * (1.0 + noise.speed_ratio * e[i]) for i, v in enumerate(command.speeds)]
            angles = [a + noise.angle * e[4 + i] for i, a in enumerate(command.angles)]
            odometry.update(JointStates(k * dt, speeds, angles, [0.0] * 4), k * dt)
            if k:
                mean = Twist(*((a + b) / 2.0 for a, b in zip(twist, last, strict=True)))
                true = true.moved(se2.exp(mean, dt))
            last = twist
        total += nees(true.relative_to(odometry.pose), odometry.covariance)
    # 75 degrees of freedom.  The simulated noise has no floors, so the result may be below 1.
    assert 0.65 <= total / runs / 3.0 <= 1.35


def nees(e: Pose2, p: se2.Cov3) -> float:
    """Returns e' P^-1 e, by elimination."""
    a = [[*row, v] for row, v in zip(p, e, strict=True)]
    for i in range(3):
        for j in range(3):
            if j != i:
                f = a[j][i] / a[i][i]
                a[j] = [u - f * v for u, v in zip(a[j], a[i], strict=True)]
    return sum(v * a[i][3] / a[i][i] for i, v in enumerate(e))


def held(odometry: Odometry, twist: Twist, start: float, seconds: float) -> float:
    """Drives with one wheel that stands while the others turn as commanded."""
    for k in range(1, round(seconds / 0.02) + 1):
        states = joints(odometry, twist, start + k * 0.02)
        speeds = [*states.speeds[:3], 0.0]
        stalled = JointStates(states.time, speeds, states.angles, states.angle_rates)
        odometry.update(stalled, states.time)
    return start + round(seconds / 0.02) * 0.02


@pytest.mark.parametrize("seconds", [0.1, 0.3, 2.0])
def test_the_error_of_an_undecided_time_is_the_same_in_all_of_its_ticks(seconds: float) -> None:
    """However short it is: either the robot moved as its wheels say, or not at all."""
    odometry = make_odometry()
    now = driven(odometry, Twist(0.6, 0.0, 0.0), 0.0, 2.06)
    before = odometry.pose.x
    held(odometry, Twist(0.6, 0.0, 0.0), now, seconds)
    sigma = math.sqrt(odometry.covariance[0][0])
    assert (odometry.pose.x - before) / sigma < 3.0
    assert sigma < 0.8 * 0.6 * seconds + 0.02


def test_an_undecided_yaw_is_an_error_of_all_later_positions() -> None:
    odometry = make_odometry()
    now = driven(odometry, Twist(0.6, 0.0, 0.4), 0.0, 2.0)
    now = held(odometry, Twist(0.6, 0.0, 0.4), now, 1.0)
    yaw, across = (math.sqrt(odometry.covariance[i][i]) for i in (2, 1))
    driven(odometry, Twist(0.6, 0.0, 0.0), now + 0.02, now + 10.0)
    assert math.sqrt(odometry.covariance[1][1]) > across + 0.8 * yaw * 0.6 * 10.0


def test_undecided_errors_do_not_cancel_when_the_robot_turns_around() -> None:
    odometry = make_odometry()
    now = held(odometry, Twist(0.6, 0.0, 0.0), driven(odometry, Twist(0.6, 0, 0), 0, 1), 2.0)
    sigma = math.sqrt(odometry.covariance[0][0])
    now = driven(odometry, Twist(0.0, 0.0, math.pi / 4), now + 0.02, now + 4.0)
    held(odometry, Twist(0.6, 0.0, 0.0), now, 2.0)
    assert math.sqrt(odometry.covariance[0][0]) > 1.2 * sigma


@pytest.mark.parametrize(("pause", "growth"), [(2.0, 2.0), (12.0, math.sqrt(2.0))])
def test_two_undecided_times_have_the_same_cause_if_they_are_close(
    pause: float, growth: float
) -> None:
    odometry = make_odometry()
    now = held(odometry, Twist(0.6, 0.0, 0.0), driven(odometry, Twist(0.6, 0, 0), 0, 1), 2.0)
    sigma = math.sqrt(odometry.covariance[0][0])
    now = driven(odometry, Twist(0.0, 0.0, 0.0), now + 0.02, now + pause)
    held(odometry, Twist(0.6, 0.0, 0.0), now, 2.0)
    assert math.sqrt(odometry.covariance[0][0]) == pytest.approx(growth * sigma, rel=0.05)


def test_undecided_errors_do_not_depend_on_the_pose() -> None:
    """The covariance is that of a small motion in base_link."""
    covariances = []
    for pose in (ORIGIN, Pose2(50.0, -30.0, 2.0)):
        odometry = make_odometry()
        now = driven(odometry, Twist(0.6, 0.0, 0.4), 0.0, 1.0)
        odometry.reset(pose)
        held(odometry, Twist(0.6, 0.0, 0.4), now, 1.0)
        covariances.append([value for row in odometry.covariance for value in row])
    assert covariances[1] == pytest.approx(covariances[0], rel=1e-6, abs=1e-9)
