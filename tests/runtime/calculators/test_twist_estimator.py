"""The twist estimator: efficiency, rank and covariance, unweighted least squares."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from tests.conformance.wheels import wheel
from thorvaldc.model.spatial import symmetric_eigenvalues
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise, WheelGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.calculators.twist_estimator import EstimatorOptions, TwistEstimator
from thorvaldc.runtime.se2 import Twist

ROBOTS = {
    "4WD4WS": [
        wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate([(0.6, 0.4), (0.6, -0.4)])
    ]
    + [wheel("w2", -0.6, 0.4, "steered"), wheel("w3", -0.6, -0.4, "steered")],
    "6WD6WS asymmetric": [
        wheel(f"w{i}", x, y, "steered")
        for i, (x, y) in enumerate(
            [(1.0, 0.6), (0.9, -0.6), (0.2, 0.7), (-0.1, -0.7), (-1.0, 0.6), (-0.8, -0.6)]
        )
    ],
    "4WD2WS": [
        wheel("w0", 0.6, 0.4, "steered"),
        wheel("w1", 0.6, -0.4, "steered"),
        wheel("w2", -0.6, 0.4, "fixed"),
        wheel("w3", -0.6, -0.4, "fixed"),
    ],
}


def solve(m: tuple[tuple[float, ...], ...], b: tuple[float, ...]) -> list[float]:
    a = [[*row, v] for row, v in zip(m, b, strict=True)]
    for i in range(3):
        for j in range(3):
            if j != i:
                f = a[j][i] / a[i][i]
                a[j] = [p - f * q for p, q in zip(a[j], a[i], strict=True)]
    return [a[i][3] / a[i][i] for i in range(3)]


@pytest.mark.parametrize("name", ROBOTS)
def test_errors_agree_with_the_covariance(name: str) -> None:
    """sqrt(NEES / 3) is near 1 for random motions with the assumed noise."""
    random.seed(3)
    geometry = BaseGeometry.from_wheels(ROBOTS[name])
    noise = Noise()
    estimator = TwistEstimator(geometry, noise)
    total, n = 0.0, 1500
    for _ in range(n):
        calculator = General(geometry)
        twist = Twist(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1))
        command = calculator.command(twist)
        angles = [
            a + random.gauss(0.0, noise.angle)
            for a, w in zip(command.joints.angles, geometry.wheels, strict=True)
        ]
        speeds = [
            v * (1 + random.gauss(0.0, noise.speed_ratio))
            + random.gauss(0.0, noise.speed_floor) / 0.2
            for v in command.joints.speeds
        ]
        zeros = [0.0] * len(angles)
        estimate = estimator.estimate(JointStates(0.0, speeds, angles, zeros))
        e = tuple(p - q for p, q in zip(estimate.twist, command.target, strict=True))
        total += sum(p * q for p, q in zip(e, solve(estimate.covariance, e), strict=True))
    # The assumed side slip is not part of this noise, so the result may be below 1.
    assert 0.75 <= math.sqrt(total / n / 3) <= 1.15


def estimate_of(wheels: list[WheelGeometry], speeds: list[float], angles: list[float]):  # type: ignore[no-untyped-def]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    return estimator.estimate(JointStates(0.0, speeds, angles, [0.0] * len(speeds)))


def test_one_wheel_with_casters_has_rank_2() -> None:
    wheels = [wheel("d", 0.5, 0.0, "steered"), wheel("c", -0.5, 0.3, "swivel")]
    estimate = estimate_of(wheels, [5.0, 0.0], [0.0, 0.0])
    assert estimate.rank == 2
    assert estimate.twist.vx == pytest.approx(1.0, abs=1e-3)
    # A rotation about the wheel is not measured, so its variance is large.
    assert math.sqrt(estimate.covariance[2][2]) > 0.5
    assert min(symmetric_eigenvalues(estimate.covariance)) < 1e-3


def test_one_wheel_with_a_fixed_axle_has_rank_3() -> None:
    wheels = [wheel("d", 0.5, 0.0, "steered"), wheel("p", -0.5, 0.3, "passive")]
    estimate = estimate_of(wheels, [5.0, 0.0], [0.3, 0.0])
    assert estimate.rank == 3
    assert estimate.twist.wz == pytest.approx(math.sin(0.3) / 1.0, abs=1e-9)


def test_casters_alone_have_rank_0() -> None:
    estimate = estimate_of([wheel("c", 0.5, 0.0, "swivel")], [3.0], [0.2])
    assert estimate.rank == 0
    assert estimate.twist == pytest.approx((0.0, 0.0, 0.0))


def test_steering_a_wheel_beside_its_axis_is_no_motion() -> None:
    """A contact 0.1 m beside the steering axis rolls as the joint turns, while the robot stands."""
    wheels = [
        wheel(f"w{i}", x, y, "steered", lateral=0.1, sign=s)
        for i, (x, y, s) in enumerate([(0.5, 0.4, 1.0), (0.5, -0.4, -1.0), (-0.5, 0.0, 1.0)])
    ]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    rate = 2.0
    speeds = [-w.sign * rate * w.lateral / w.radius for w in wheels]
    estimate = estimator.estimate(JointStates(0.0, speeds, [0.3, -0.2, 1.0], [rate] * 3))
    assert estimate.twist == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_wheels_far_from_base_link_lose_no_digits() -> None:
    shift = 1000.0
    wheels = [wheel(f"w{i}", x + shift, y, "steered") for i, (x, y) in enumerate([(0, 1), (1, 0)])]
    calculator = General(BaseGeometry.from_wheels(wheels))
    command = calculator.command(Twist(0.3, 0.5 - 0.0004 * shift, 0.0004))
    estimate = calculator.odometry(
        JointStates(0.0, command.joints.speeds, command.joints.angles, [0.0, 0.0])
    )
    assert estimate.twist == pytest.approx(command.target, abs=1e-9)


def noisy_joints(
    wheels: list[WheelGeometry], rng: random.Random, noise: float = 1.0
) -> JointStates:
    """Joints of a random motion; ``noise`` multiplies the default standard deviations."""
    geometry = BaseGeometry.from_wheels(wheels)
    twist = Twist(*(rng.uniform(-1.0, 1.0) for _ in range(3)))
    joints = General(geometry).command(twist).joints
    speeds = [v * (1.0 + noise * rng.gauss(0.0, 0.01)) for v in joints.speeds]
    angles = [
        a + (noise * rng.gauss(0.0, 0.0087) if w.steered else 0.0)
        for a, w in zip(joints.angles, wheels, strict=True)
    ]
    return JointStates(0.0, speeds, angles, [0.0] * len(wheels))


def closed_form(wheels: list[WheelGeometry], states: JointStates) -> tuple[float, float, float]:
    """Least squares of wheel velocities u at positions (x', y') relative to the centroid:

    wz = sum(x' u_y - y' u_x) / sum(x'^2 + y'^2), vx = mean(u_x) + wz ym, vy = mean(u_y) - wz xm.
    """
    points = []
    for w, speed, angle in zip(wheels, states.speeds, states.angles, strict=True):
        if not w.swivel:
            direction = w.heading + w.sign * angle
            v = w.radius * speed
            points.append((w.x, w.y, v * math.cos(direction), v * math.sin(direction)))
    n = len(points)
    xm, ym, mean_x, mean_y = (sum(p[k] for p in points) / n for k in range(4))
    moment = sum((x - xm) * uy - (y - ym) * ux for x, y, ux, uy in points)
    wz = moment / sum((x - xm) ** 2 + (y - ym) ** 2 for x, y, _, _ in points)
    return mean_x + wz * ym, mean_y - wz * xm, wz


@pytest.mark.parametrize("count", [2, 3, 4, 6, 9, 20])
def test_unweighted_least_squares_equals_the_closed_form(count: int) -> None:
    rng = random.Random(count)
    wheels = [
        wheel(
            f"w{i}",
            rng.uniform(-2.0, 2.0),
            rng.uniform(-2.0, 2.0),
            "swivel" if i > 1 and rng.random() < 0.3 else "steered",
            heading=rng.choice([0.0, 0.3, math.pi]),
            sign=rng.choice([1.0, -1.0]),
            radius=rng.choice([0.1, 0.2]),
        )
        for i in range(count)
    ]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    for _ in range(10):
        states = noisy_joints(wheels, rng, noise=5.0)
        expected = closed_form(wheels, states)
        assert estimator.least_squares(states) == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_least_squares_of_one_wheel_has_no_rotation() -> None:
    estimator = TwistEstimator(BaseGeometry.from_wheels([wheel("w", 0.5, 0.1, "steered")]))
    twist = estimator.least_squares(JointStates(0.0, (5.0,), (0.0,), (0.0,)))
    assert twist == pytest.approx((1.0, 0.0, 0.0), abs=1e-5)


def test_a_suspect_wheel_is_dropped_only_if_the_options_allow_it() -> None:
    wheels = ROBOTS["4WD4WS"]
    geometry = BaseGeometry.from_wheels(wheels)
    states = noisy_joints(wheels, random.Random(1), noise=0.2)
    healthy = TwistEstimator(geometry).estimate(states)
    assert healthy.dropped == ()
    states.speeds = [1.3 * states.speeds[0], *states.speeds[1:]]
    estimate = TwistEstimator(geometry).estimate(states)
    assert estimate.dropped == (0,)
    test_only = TwistEstimator(geometry, None, EstimatorOptions(faulty=0)).estimate(states)
    assert test_only.dropped == ()
    gates = TwistEstimator(geometry).gates
    assert any(d > gate for d, gate in zip(test_only.chi_squares, gates, strict=True))
    assert test_only.twist != estimate.twist
    # Without rejection, the misfit does not change the covariance.
    assert test_only.covariance[2][2] < 2.0 * healthy.covariance[2][2]


def test_a_gyro_pulls_the_yaw_rate() -> None:
    wheels = ROBOTS["4WD4WS"]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    states = noisy_joints(wheels, random.Random(1), noise=0.2)
    wz = estimator.estimate(states).twist.wz
    states.yaw_rate = wz + 0.001
    assert wz < estimator.estimate(states).twist.wz < states.yaw_rate


def test_chi_squares_count_only_wheels_that_measure() -> None:
    wheels = [*ROBOTS["4WD4WS"], wheel("c", 0.0, 0.0, "swivel")]
    states = noisy_joints(wheels, random.Random(2))
    estimate = TwistEstimator(BaseGeometry.from_wheels(wheels)).estimate(states)
    assert estimate.chi_squares[4] == 0.0
    assert min(estimate.chi_squares[:4]) > 0.0


def test_weights_of_the_fit_are_those_of_the_assumed_noise() -> None:
    """Near the centre of a turn a wheel is slow, so its measurements count more."""
    places = [(0.6, 0.4), (0.6, -0.4), (-0.6, 0.4), (-0.6, -0.4)]
    noise = Noise(speed_ratio=0.03, angle=0.02, speed_floor=0.004, slip_floor=0.001)
    geometry = BaseGeometry.from_wheels(
        [wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate(places)]
    )
    estimator = TwistEstimator(geometry, noise, EstimatorOptions(faulty=0))
    command = General(geometry).command(Twist(0.5, 0.2, 1.0))
    speeds = [v + e for v, e in zip(command.joints.speeds, (0.2, -0.1, 0.3, -0.4), strict=True)]
    errors = (0.02, -0.01, 0.03, 0.01)
    angles = [a + e for a, e in zip(command.joints.angles, errors, strict=True)]
    states = JointStates(0.0, speeds, angles, [0.0] * 4)
    first = estimator.least_squares(states)
    information, right_side = np.zeros((3, 3)), np.zeros(3)
    for (x, y), speed, angle, w in zip(places, speeds, angles, geometry.wheels, strict=True):
        rows = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        velocity = rows @ np.array(first)
        size = float(np.linalg.norm(velocity))
        measured = np.array([math.cos(angle), math.sin(angle)])
        along = velocity / size * np.sign(measured @ velocity)
        across = np.array([-along[1], along[0]])
        side = float(np.array([-measured[1], measured[0]]) @ velocity)
        side_slip = -size * math.asin(side / size)
        for direction, value, ratio, floor in (
            (along, speed * w.radius, noise.speed_ratio, noise.speed_floor),
            (across, side_slip, noise.angle, noise.slip_floor),
        ):
            row = direction @ rows
            weight = 1.0 / ((ratio * size) ** 2 + floor**2)
            information += weight * np.outer(row, row)
            right_side += weight * value * row
    estimate = estimator.estimate(states)
    expected = np.linalg.solve(information, right_side)
    assert list(estimate.twist) == pytest.approx(expected.tolist(), abs=1e-6)
    assert np.array(estimate.covariance) == pytest.approx(np.linalg.inv(information), rel=1e-6)
    assert np.abs(expected - np.array(first)).max() > 0.01  # the weights matter


def test_a_calculator_that_commanded_nothing_suspects_no_wheel() -> None:
    """What a robot was commanded is unknown then, and not zero: two wheels in a turn differ."""
    geometry = BaseGeometry.from_wheels(
        [wheel("l", 0.0, 0.4, "fixed"), wheel("r", 0.0, -0.4, "fixed")]
    )
    calculator, zeros = General(geometry), (0.0, 0.0)
    turn = JointStates(0.0, (3.0, 5.0), zeros, zeros)
    unknown = calculator.odometry(turn)
    assert (unknown.suspects, unknown.sliding, unknown.dropped) == ((), (), ())
    calculator.command(unknown.twist)
    assert calculator.odometry(turn).covariance == pytest.approx(np.array(unknown.covariance))
    calculator.command(Twist(0.0, 0.0, 0.0))
    assert calculator.odometry(turn).suspects  # a push, or wrong encoders
