"""Wrong wheel radii and steering zeros in the covariance of the pose."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise, WheelGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import ORIGIN, Pose2, Twist

FOUR = [
    wheel(f"w{i}", x, y, "steered")
    for i, (x, y) in enumerate([(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)])
]
FIVE = [
    *(wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate([(0.9, 0.4), (0.6, -0.5)])),
    *(wheel(f"f{i}", -0.3, y, "fixed") for i, y in enumerate([0.5, -0.4])),
    wheel("c", -1.0, 0.0, "swivel"),
]
RANDOM_ONLY = Noise(correlation=0.0, radius_error=0.0, steering_offset_error=0.0)
CONSTANT = Noise(correlation=0.0)
RADIUS, ZERO = 0.01, math.radians(0.5)
DT = 0.05
FORWARD = [Twist(0.8, 0.0, 0.0)] * 200
WHOLE_BLOCKS = 9.6
"""Time (s) of the motion ``FORWARD`` in whole blocks of 0.4 s."""
LOOP = [Twist(0.8, 0.2 * math.sin(0.02 * k), 0.3 * math.cos(0.013 * k)) for k in range(400)]


def drive(
    wheels: list[WheelGeometry],
    twists: list[Twist],
    noise: Noise | None = None,
    radii: list[float] | None = None,
    zeros: list[float] | None = None,
    rng: random.Random | None = None,
) -> tuple[Odometry, Pose2]:
    """Returns the odometry after the motion, and the true pose.

    ``radii`` and ``zeros`` are the relative errors of the radii and the errors of the zeros (rad).
    The zero of a fixed wheel is its direction in ``base_link``.  With ``rng``, each joint state
    also has random errors of 1 % and 0.5 deg.
    """
    noise = noise or CONSTANT
    inverse = General(BaseGeometry.from_wheels(wheels))
    if zeros is not None:  # a steered wheel at a constant angle is a fixed wheel with an error
        wheels = [w if w.swivel else replace(w, steered=True) for w in wheels]
    odometry = Odometry(General(BaseGeometry.from_wheels(wheels), None, noise), (1.5, 1.0))
    n = len(wheels)
    radii, zeros = radii or [0.0] * n, zeros or [0.0] * n
    pose, last = ORIGIN, None
    for k, twist in enumerate(twists):
        twist = inverse.feasible(twist)
        command = inverse.command(twist).joints
        speeds = [v * (1.0 + r) for v, r in zip(command.speeds, radii, strict=True)]
        angles = [a + z for a, z in zip(command.angles, zeros, strict=True)]
        if rng is not None:
            speeds = [v * (1.0 + rng.gauss(0.0, RADIUS)) for v in speeds]
            angles = [
                a + rng.gauss(0.0, ZERO) * w.steered for a, w in zip(angles, wheels, strict=True)
            ]
        odometry.update(JointStates(k * DT, speeds, angles, [0.0] * n), k * DT)
        if last is not None:
            mean = Twist(*((a + b) / 2.0 for a, b in zip(last, twist, strict=True)))
            pose = pose.moved(se2.exp(mean, DT))
        last = twist
    return odometry, pose


def share(wheels: list[WheelGeometry], twists: list[Twist], noise: Noise) -> np.ndarray:
    """Returns the covariance of the pose from lasting errors alone."""
    total = drive(wheels, twists, noise)[0].covariance
    random_part = drive(
        wheels,
        twists,
        replace(noise, radius_error=0.0, scale_error=0.0, steering_offset_error=0.0),
    )[0].covariance
    return np.array(total) - np.array(random_part)


@pytest.mark.parametrize("twists", [FORWARD, LOOP], ids=["forward", "loop"])
@pytest.mark.parametrize("wheels", [FOUR, FIVE], ids=["4WD4WS", "4WD2WS"])
def test_covariance_is_that_of_small_errors_of_each_wheel(
    wheels: list[WheelGeometry], twists: list[Twist]
) -> None:
    """Sums the pose errors of single wrong wheels, which the odometry itself shows."""
    small = 0.02  # of a standard deviation, so that second-order effects vanish
    noise = Noise(correlation=0.0, radius_error=small * RADIUS, steering_offset_error=small * ZERO)
    correct = drive(wheels, twists)[0].pose
    expected = np.zeros((3, 3))
    for i, w in enumerate(wheels):
        for kind, size in (("radii", small * RADIUS), ("zeros", small * ZERO)):
            if w.swivel:
                continue
            errors = [size if j == i else 0.0 for j in range(len(wheels))]
            wrong = drive(wheels, twists, None, **{kind: errors})[0].pose
            error = np.array(correct.relative_to(wrong))
            expected += np.outer(error, error)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(share(wheels, twists, noise) - expected).max() <= 0.05 * scale.max()
    assert np.abs((share(wheels, twists, noise) - expected) / scale).max() <= 0.08


@pytest.mark.parametrize("kind", ["lasting", "lasting and random"])
@pytest.mark.parametrize("wheels", [FOUR, FIVE], ids=["4WD4WS", "4WD2WS"])
def test_pose_errors_of_wrong_wheels_agree_with_the_covariance(
    wheels: list[WheelGeometry], kind: str
) -> None:
    """NEES / 3 is near 1.  With random errors only, it was over 100."""
    rng = random.Random(3)
    total, runs = 0.0, 30
    for _ in range(runs):
        radii = [rng.gauss(0.0, RADIUS) for _ in wheels]
        zeros = [rng.gauss(0.0, ZERO) * (not w.swivel) for w in wheels]
        noisy = rng if "random" in kind else None
        odometry, true = drive(wheels, LOOP[::2], None, radii, zeros, noisy)
        error = np.array(true.relative_to(odometry.pose))
        total += float(error @ np.linalg.solve(np.array(odometry.covariance), error))
    assert 0.6 <= total / runs / 3.0 <= 1.35


def test_large_yaw_errors_agree_with_the_covariance() -> None:
    """With a yaw error of 20 deg, NEES / 3 without the second order is over 3."""
    rng = random.Random(5)
    noise = Noise(correlation=0.0, radius_error=0.03, steering_offset_error=0.0)
    total, runs = 0.0, 40
    for _ in range(runs):
        radii = [rng.gauss(0.0, 0.03) for _ in FOUR]
        odometry, true = drive(FOUR, LOOP, noise, radii)
        pose = true.relative_to(odometry.pose)
        half = pose.yaw / 2.0
        k = half / math.tan(half)  # logarithm of the pose
        error = np.array([k * pose.x + half * pose.y, k * pose.y - half * pose.x, pose.yaw])
        total += float(error @ np.linalg.solve(np.array(odometry.covariance), error))
    assert 0.6 <= total / runs / 3.0 <= 1.4


def test_errors_that_last_some_seconds_have_their_exact_variance() -> None:
    """Variance of the integral of errors with the autocorrelation exp(-t / tau)."""
    tau, time = 2.0, WHOLE_BLOCKS
    white = drive(FOUR, FORWARD, RANDOM_ONLY)[0]
    lasting = drive(FOUR, FORWARD, replace(RANDOM_ONLY, correlation=tau))[0]
    exact = 2.0 * tau * (time - tau * (1.0 - math.exp(-time / tau)))
    for i in (0, 2):  # the sideways position also contains the yaw error
        expected = exact * white.estimate.covariance[i][i]
        assert lasting.covariance[i][i] - white.covariance[i][i] == pytest.approx(
            expected, rel=1e-6
        )


def test_errors_that_last_some_seconds_on_a_curve() -> None:
    """The double sum over all blocks, with A the adjoint of the pose in the middle of a block."""
    tau, dt, ticks = 1.5, 1 / 16, 7  # ticks in a block
    block = dt * ticks
    inverse = General(BaseGeometry.from_wheels(FIVE))
    random_only, lasting = (
        Odometry(General(BaseGeometry.from_wheels(FIVE), None, noise), (1.5, 1.0))
        for noise in (RANDOM_ONLY, replace(RANDOM_ONLY, correlation=tau))
    )
    poses, products = [ORIGIN], []
    for k in range(10 * ticks + 1):
        twist = inverse.feasible(Twist(0.8, 0.0, 0.9 * math.cos(0.03 * k)))
        joints = inverse.command(twist).joints
        states = JointStates(k * dt, list(joints.speeds), list(joints.angles), [0.0] * 5)
        for odometry in (random_only, lasting):
            odometry.update(states, k * dt)
        if k and k % ticks == 0:
            start, end = poses[-1], random_only.pose
            yaw = (start.yaw + end.yaw) / 2.0
            c, s, x, y = math.cos(yaw), math.sin(yaw), start.x + end.x, start.y + end.y
            adjoint = np.array([[c, -s, y / 2.0], [s, c, -x / 2.0], [0.0, 0.0, 1.0]])
            products.append((adjoint, adjoint @ np.array(random_only.estimate.covariance)))
            poses.append(end)
    decay = math.exp(-block / tau)
    mean = tau * (1.0 - decay)
    expected = np.zeros((3, 3))
    for k, (adjoint, product) in enumerate(products):
        expected += 2.0 * tau * (block - mean) * product @ adjoint.T
        for j, (_, earlier) in enumerate(products[:k]):
            part = mean * mean * decay ** (k - j - 1) * earlier @ adjoint.T
            expected += part + part.T
    pose = lasting.pose
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    inward = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array(
        [[1.0, 0.0, -pose.y], [0.0, 1.0, pose.x], [0.0, 0.0, 1.0]]
    )
    growth = np.array(lasting.covariance) - np.array(random_only.covariance)
    assert growth == pytest.approx(inward @ expected @ inward.T, rel=1e-6, abs=1e-12)


def test_common_error_of_all_radii() -> None:
    noise = replace(RANDOM_ONLY, scale_error=1e-4)
    covariance = share(FOUR, FORWARD, noise)
    assert math.sqrt(covariance[0][0]) == pytest.approx(1e-4 * 0.8 * WHOLE_BLOCKS)
    assert covariance[2][2] == pytest.approx(0.0, abs=1e-15)


def test_standard_deviation_grows_with_the_distance() -> None:
    noise = Noise(correlation=0.0, radius_error=1e-4, steering_offset_error=0.0)
    sizes = [math.sqrt(share(FOUR, FORWARD * n, noise)[0][0]) for n in (1, 4)]
    assert sizes[1] / sizes[0] == pytest.approx(4.0, rel=0.05)
    # The mean radius of four wheels has half of the error of one wheel.
    assert sizes[1] == pytest.approx(0.5 * 1e-4 * 0.8 * 799 * DT, rel=0.05)


def test_errors_of_the_way_out_cancel_on_the_way_back() -> None:
    """Wheels of 1 % too much show 1 % too much in both directions."""
    back = [t.scaled(-1.0) for t in FORWARD]
    there = share(FOUR, FORWARD, CONSTANT)
    returned = share(FOUR, [*FORWARD, *back], CONSTANT)
    assert math.sqrt(np.trace(returned)) <= 0.05 * math.sqrt(np.trace(there))


def test_standing_robot_gains_no_lasting_error() -> None:
    still = [Twist(0.0, 0.0, 0.0)] * 200
    assert share(FOUR, still, CONSTANT) == pytest.approx(np.zeros((3, 3)), abs=1e-15)


def test_pose_does_not_depend_on_the_lasting_part() -> None:
    some = drive(FOUR, LOOP, None, None, None, random.Random(1))[0]
    none = drive(FOUR, LOOP, RANDOM_ONLY, None, None, random.Random(1))[0]
    assert some.pose == none.pose
    assert some.estimate == none.estimate


def test_reset_forgets_the_drive_before() -> None:
    odometry, _ = drive(FOUR, FORWARD)
    odometry.reset(Pose2(100.0, -50.0, 2.0))
    start = len(FORWARD) * DT
    joints = odometry.joints
    assert joints is not None
    for k in range(200):
        odometry.update(replace(joints, time=start + k * DT), start + k * DT)
    fresh = np.array(drive(FOUR, FORWARD)[0].covariance)
    assert np.array(odometry.covariance) == pytest.approx(fresh, rel=0.05, abs=1e-6)


def test_errors_of_new_radii_are_independent_of_the_old_ones() -> None:
    """The way back with other wheels does not cancel the errors of the way out."""
    odometry, _ = drive(FOUR, FORWARD)
    there = odometry.covariance[0][0]
    joints = odometry.joints
    assert joints is not None
    noise = odometry.calculator.noise
    odometry.calculator = odometry.calculator.with_parameters([0.25] * 4, noise)
    speeds = [-v * 0.2 / 0.25 for v in joints.speeds]
    start = len(FORWARD) * DT
    for k in range(200):
        states = replace(joints, time=start + k * DT, speeds=speeds)
        odometry.update(states, start + k * DT)
    assert odometry.covariance[0][0] == pytest.approx(2.0 * there, rel=0.1)


def test_stated_lasting_error_counts_as_error_of_each_tick() -> None:
    """A radius error of 3 % is an error of 3 % in every tick, whatever ``speed_ratio`` is."""
    assert Noise().lasting_errors == (0.01, 0.0, math.radians(0.5))
    assert Noise(speed_ratio=0.03).lasting_errors[0] == 0.03
    wide = Noise(radius_error=0.03, steering_offset_error=0.1)
    assert (wide.rolling, wide.direction) == (0.03, 0.1)
    assert wide.squares[:2] == pytest.approx((9e-4, 0.01))
    assert Noise(radius_error=0.001).squares == Noise().squares
