"""Ramps between twists: smoothed corners, straight lines, limited lead."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from thorvaldc.model import DriverSettings
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.twist_ramp import LEAD, Ramp

SETTINGS = DriverSettings(50.0, 0.5, 1.5, 1.0, 1.5, 1.0, 1.5, 1.0)
DT = 0.02


def steps(ramp: Ramp, goal: Twist, seconds: float) -> list[Twist]:
    return [ramp.step(goal, DT) for _ in range(round(seconds / DT))]


def test_acceleration_begins_and_ends_gently() -> None:
    ramp = Ramp(SETTINGS, 1.0, 0.2)
    seen = [0.0, 0.0, *(twist.vx for twist in steps(ramp, Twist(1.2, 0.0, 0.0), 2.0))]
    accelerations = [(b - a) / DT for a, b in pairwise(seen)]
    jerks = [(b - a) / DT for a, b in pairwise(accelerations)]
    assert max(accelerations) == pytest.approx(1.5)
    assert max(map(abs, jerks)) <= 1.5 / 0.2 + 1e-6
    assert seen[-1] == 1.2
    without = [t.vx for t in steps(Ramp(SETTINGS, 1.0, 0.0), Twist(1.2, 0.0, 0.0), 2.0)]
    # The delay is half of the smoothing time.
    assert sum(without) - sum(seen) == pytest.approx(1.2 * 0.1 / DT)


def test_ramps_from_rest_and_to_rest_keep_the_centre_of_rotation() -> None:
    ramp, goal = Ramp(SETTINGS, 1.0, 0.2), Twist(0.8, -0.2, 0.5)
    for twist in (*steps(ramp, goal, 1.5), *steps(ramp, ZERO_TWIST, 1.5)):
        assert twist.vx * goal.wz == pytest.approx(twist.wz * goal.vx, abs=1e-12)
        assert twist.vx * goal.vy == pytest.approx(twist.vy * goal.vx, abs=1e-12)
    assert ramp.twist == ZERO_TWIST


def test_direction_of_the_ramp_does_not_follow_turning_wheels() -> None:
    """Wheels with trail push the robot sideways while they turn; the ramp does not."""
    ramp, goal = Ramp(SETTINGS, 2.0, 0.2), Twist(0.0, 0.8, 0.0)
    steps(ramp, goal, 2.0)
    ramp.limit_lead(goal, Twist(-0.2, 0.4, 0.1))
    assert ramp.twist == pytest.approx((0.0, 0.4 + LEAD, 0.0))
    ramp.limit_lead(goal, Twist(0.3, -0.4, 0.1))
    assert ramp.twist == pytest.approx((0.0, LEAD - 0.4, 0.0))


def test_ramp_does_not_wait_for_what_the_wheels_cannot_make() -> None:
    ramp, goal = Ramp(SETTINGS, 2.0, 0.2), Twist(0.8, 0.0, 0.4)
    steps(ramp, goal, 2.0)
    ramp.limit_lead(Twist(0.1, 0.0, 0.4), Twist(0.1, 0.0, 0.4), True, Twist(0.7, 0.0, 0.0))
    assert ramp.twist == pytest.approx(goal)


def test_ramp_waits_for_the_wheels() -> None:
    ramp = Ramp(SETTINGS, 2.0, 0.2)
    steps(ramp, Twist(1.0, 0.0, 0.4), 2.0)
    ramp.limit_lead(Twist(0.2, 0.0, 0.0), Twist(0.2, 0.0, 0.0))
    ahead = math.hypot(ramp.twist.vx - 0.2, 2.0 * ramp.twist.wz)
    assert ahead == pytest.approx(LEAD)
    steps(ramp, Twist(1.0, 0.0, 0.4), 2.0)
    ramp.limit_lead(Twist(1.0, 0.0, 0.4), Twist(0.2, 0.0, 0.0), aligned=False)
    size = math.hypot(ramp.twist.vx, 2.0 * ramp.twist.wz)
    assert size == pytest.approx(0.2 * ramp.twist.vx / size + LEAD)
    assert ramp.twist.wz / ramp.twist.vx == pytest.approx(0.4)
    following = ramp.step(Twist(1.0, 0.0, 0.4), DT)
    assert following.vx - ramp.twist.vx < 1.5 * DT + 1e-9
    ramp.restart(ZERO_TWIST)
    assert ramp.step(ZERO_TWIST, DT) == ZERO_TWIST


def test_ramp_at_the_speed_limits_takes_the_direction_of_its_goal_without_growing() -> None:
    ramp, goal = Ramp(SETTINGS, 0.5, 0.0), Twist(0.9, 0.9, 0.0)
    ramp.restart(Twist(0.6, 0.0, 0.0))
    for _ in range(60):
        twist = ramp.step(goal, DT, grows=False)
        assert twist.speed <= 0.6 + 1e-12
    assert twist.vx == pytest.approx(twist.vy, abs=1e-12)
    assert twist.speed > 0.5
    assert steps(ramp, goal, 2.0)[-1] == goal
