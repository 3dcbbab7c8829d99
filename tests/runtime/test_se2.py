"""Planar motion on SE(2): integration and covariance."""

from __future__ import annotations

import math
import random

import pytest

from thorvaldc.runtime import se2
from thorvaldc.runtime.se2 import ORIGIN, ZERO_COV, Pose2, Twist


@pytest.mark.parametrize("wz", [0.0, 1e-9, 9.9e-4, -1.1e-3, 0.3, -2.0])
def test_exp_is_the_limit_of_small_steps(wz: float) -> None:
    twist = Twist(0.8, -0.3, wz)
    pose = ORIGIN
    n = 20000
    for k in range(n):  # midpoint rule
        yaw = wz * (k + 0.5) / n
        c, s = math.cos(yaw), math.sin(yaw)
        pose = Pose2(
            pose.x + (c * twist.vx - s * twist.vy) / n,
            pose.y + (s * twist.vx + c * twist.vy) / n,
            wz * (k + 1) / n,
        )
    assert se2.exp(twist, 1.0) == pytest.approx(pose, abs=1e-9)


def test_series_and_closed_form_agree() -> None:
    for a in (1e-3 * (1 - 1e-12), 1e-3 * (1 + 1e-12)):
        step = se2.exp(Twist(1.0, 0.0, a), 1.0)
        assert step.x == pytest.approx(math.sin(1e-3) / 1e-3, abs=1e-14)
        assert step.y == pytest.approx((1 - math.cos(1e-3)) / 1e-3, abs=1e-13)


def test_motion_in_one_step_equals_motion_in_many() -> None:
    twist = Twist(1.0, 0.2, 0.7)
    pose = ORIGIN
    for _ in range(770):
        pose = pose.moved(se2.exp(twist, 0.1))
    assert pose == pytest.approx(se2.exp(twist, 77.0), abs=1e-10)


def test_relative_to_undoes_moved() -> None:
    a, step = Pose2(1.0, -2.0, 2.5), Pose2(0.4, 0.1, -1.0)
    assert a.moved(step).relative_to(a) == pytest.approx(step, abs=1e-14)


def test_chord_over_arc() -> None:
    step = se2.exp(Twist(1.0, 0.0, 1.2), 1.0)
    assert math.hypot(step.x, step.y) == pytest.approx(se2.chord_over_arc(1.2), rel=1e-14)


def log(pose: Pose2) -> list[float]:
    """Returns the twist of a small motion in 1 s."""
    half = pose.yaw / 2.0
    k = half / math.tan(half) if abs(half) > 1e-9 else 1.0
    return [k * pose.x + half * pose.y, k * pose.y - half * pose.x, pose.yaw]


@pytest.mark.parametrize("twist", [Twist(0.8, -0.5, 0.9), Twist(-0.4, 0.9, -1e-4)])
def test_covariance_agrees_with_finite_differences(twist: Twist) -> None:
    """Finite differences: a small motion before the step, and a small change of the twist."""
    dt, eps = 0.7, 1e-6
    end = se2.exp(twist, dt)
    unit = [[1.0 if i == j else 0.0 for j in range(3)] for i in range(3)]
    for constant, varied in (("twist", "pose"), ("pose", "twist")):
        for k in range(3):
            for m in range(k, 3):
                d = [eps * (a + b) / 2.0 for a, b in zip(unit[k], unit[m], strict=True)]
                if varied == "pose":
                    moved = se2.exp(Twist(*d), 1.0).moved(end)
                else:
                    changed = Twist(*(a + b / dt for a, b in zip(twist, d, strict=True)))
                    moved = se2.exp(changed, dt)
                change = [v / eps for v in log(moved.relative_to(end))]
                source = tuple(tuple(a * b / eps**2 for b in d) for a in d)
                if varied == "twist":
                    source = tuple(tuple(v / dt**2 for v in row) for row in source)
                arguments = {varied: source, constant: ZERO_COV}
                _, covariance = se2.integrate(arguments["pose"], twist, arguments["twist"], dt)
                for i in range(3):
                    for j in range(3):
                        assert covariance[i][j] == pytest.approx(change[i] * change[j], abs=1e-5)


def test_pose_covariance_agrees_with_many_runs() -> None:
    """The scatter of the ends of many noisy runs is the propagated covariance."""
    random.seed(1)
    twist, dt, n = Twist(1.0, 0.1, 0.4), 0.1, 40
    sigma = (0.05, 0.03, 0.04)
    q = ((sigma[0] ** 2, 0.0, 0.0), (0.0, sigma[1] ** 2, 0.0), (0.0, 0.0, sigma[2] ** 2))
    mean, covariance = ORIGIN, ZERO_COV
    for _ in range(n):
        mean = mean.moved(se2.exp(twist, dt))
        _, covariance = se2.integrate(covariance, twist, q, dt)
    runs = 1000
    sums = [[0.0] * 3 for _ in range(3)]
    for _ in range(runs):
        pose = ORIGIN
        for _ in range(n):
            noisy = Twist(*(v + random.gauss(0.0, s) for v, s in zip(twist, sigma, strict=True)))
            pose = pose.moved(se2.exp(noisy, dt))
        error = pose.relative_to(mean)
        for i in range(3):
            for j in range(3):
                sums[i][j] += error[i] * error[j] / runs
    for i in range(3):
        for j in range(3):
            scale = math.sqrt(covariance[i][i] * covariance[j][j])
            assert sums[i][j] == pytest.approx(covariance[i][j], abs=0.15 * scale)
