"""The choice of a steering angle, and the motion to it."""

from __future__ import annotations

import math
import random

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.calculators.steering_branch import SteeringJoint

LIMIT = 3.078027759


def steering(
    limits: tuple[float | None, float | None] = (-math.pi, math.pi), hysteresis: float = 0.02
) -> SteeringJoint:
    return SteeringJoint([wheel("w", 0.0, 0.0, "steered", limits=limits)], (0,), hysteresis)


def turned(joint: SteeringJoint, angle: float) -> SteeringJoint:
    joint.reset(angle)
    return joint


def test_chooses_the_nearer_of_two_opposite_angles() -> None:
    joint = turned(steering(), 0.2)
    joint.choose(-1.0, 0.0, 0.0, 0.2, 0.0)
    assert joint.target == pytest.approx(0.0)
    assert joint.direction == -1.0
    joint.choose(0.0, 1.0, 0.0, 0.2, 0.0)
    assert joint.target == pytest.approx(math.pi / 2)
    assert joint.direction == 1.0


def test_turns_the_long_way_at_a_cable_limit() -> None:
    """From 150 deg, a direction of -160 deg (200) is 50 deg away but past the limit."""
    angle = math.radians(150)
    joint = turned(steering((-LIMIT, LIMIT)), angle)
    joint.choose(math.cos(math.radians(200)), math.sin(math.radians(200)), 0.0, angle, 0.0)
    assert joint.target == pytest.approx(math.radians(20))
    assert joint.direction == -1.0


def test_rounding_at_the_limit_does_not_cause_half_a_turn() -> None:
    """A target at +-pi with rounding errors, in a joint limited to +-pi."""
    joint = turned(steering((-math.pi, math.pi)), math.pi)
    for k in range(50):
        noise = (-1) ** k * 1e-12
        joint.choose(-1.0, noise, 0.0, math.pi, 1.0)
        assert joint.target == pytest.approx(math.pi, abs=1e-11)
        assert joint.target <= math.pi
        assert joint.direction == 1.0


def test_no_wheel_scrubs_at_its_limit() -> None:
    """Straight back is 2.7e-6 rad beyond a limit of 3.14159: the wheel makes one half turn."""
    joint = turned(steering((-3.14159, 3.14159)), 3.14159)
    angle = 3.14159
    for k in range(50):
        joint.choose(-1.0, (-1) ** k * 1e-12, 0.0, angle, -1.0)
        angle = joint.target
        assert angle == pytest.approx(0.0, abs=1e-11)
        assert joint.direction == -1.0


def test_hysteresis_keeps_the_branch_at_equal_costs() -> None:
    joint = turned(steering(), 0.0)
    joint.choose(0.0, 1.0, 0.0, 0.0, 0.0)
    first = joint.direction
    for k in range(20):
        tilt = math.pi / 2 + (-1) ** k * 0.01
        joint.choose(math.cos(tilt), math.sin(tilt), 0.0, 0.0, 0.0)
        assert joint.direction == first


def test_fast_wheel_does_not_reverse_for_a_small_gain() -> None:
    """Turning 100 deg takes 0.44 s; stopping and reversing from 1.5 m/s takes 2 s."""
    joint = turned(steering(), 0.0)
    joint.choose(1.0, 0.0, 0.0, 0.0, 1.5)
    theta = math.radians(100)
    joint.choose(1.5 * math.cos(theta), 1.5 * math.sin(theta), 0.0, 0.0, 1.5)
    assert joint.direction == 1.0
    joint.choose(1.5 * math.cos(theta), 1.5 * math.sin(theta), 0.0, 0.0, 0.0)
    assert joint.direction == -1.0


def test_narrow_limits_may_have_no_reachable_angle() -> None:
    joint = turned(steering((-0.7, 0.7)), 0.1)
    joint.choose(0.0, 1.0, 0.0, 0.1, 0.0)
    assert joint.unreachable
    assert joint.target == 0.1
    joint.choose(-1.0, 0.2, 0.0, 0.1, 0.0)
    assert not joint.unreachable
    assert joint.target == pytest.approx(math.atan2(0.2, -1.0) - math.pi)


def test_slow_wheel_holds_and_resumes_later() -> None:
    joint = turned(steering(), 0.3)
    joint.choose(0.0, 0.0015, 0.0, 0.3, 0.0)
    assert joint.holding
    assert joint.target == 0.3
    joint.choose(0.0, 0.0025, 0.0, 0.3, 0.0)
    assert not joint.holding
    joint.choose(0.0, 0.0015, 0.0, 0.3, 0.0)
    assert not joint.holding
    joint.choose(0.0, 0.0009, 0.0, 0.3, 0.0)
    assert joint.holding


def test_wheel_with_trail_leads_the_velocity() -> None:
    joint = SteeringJoint([wheel("w", 1.0, 0.0, "steered", trail=-0.1)], (0,), 0.02)
    wz = 0.5
    joint.choose(1.0, wz * 1.0, wz, 0.0, 0.0)
    _, side = joint.wheel.rows(joint.target)
    assert side[0] * 1.0 + side[2] * wz == pytest.approx(0.0, abs=1e-12)


def test_expected_travel_is_the_mean_over_all_directions() -> None:
    """Comparison with a mean over directions, for wide, narrow and asymmetric limits."""
    for limits in ((-LIMIT, LIMIT), (-math.pi, math.pi), (-1.0, 5.0), (-math.pi / 2, math.pi / 2)):
        joint = steering(limits)
        low, high = limits
        for share in (0.0, 0.1, 0.5, 0.9, 1.0):
            at = low + share * (high - low)
            n = 4000
            total = 0.0
            for k in range(n):
                theta = math.pi * (k + 0.5) / n
                reach = [theta + math.pi * m for m in range(-4, 5)]
                total += min((abs(c - at) for c in reach if low <= c <= high), default=math.pi / 2)
            assert joint.expected_travel(at) == pytest.approx(total / n, abs=0.02)


def test_avoids_angles_near_the_limits() -> None:
    """From 80 deg, 168 deg is nearer than -12 deg, but close to the limit."""
    joint = turned(steering(), math.radians(80))
    theta = math.radians(168)
    joint.choose(math.cos(theta), math.sin(theta), 0.0, math.radians(80), 0.0)
    assert math.degrees(joint.target) == pytest.approx(-12.0)


def test_travel_is_near_the_optimum() -> None:
    """Independent directions, +-180 deg: dynamic programming has a mean of 48.04 deg."""
    random.seed(7)
    joint = turned(steering(hysteresis=0.0), 0.0)
    travel, n = 0.0, 40000
    angle = 0.0
    for _ in range(n):
        theta = random.uniform(-math.pi, math.pi)
        joint.choose(math.cos(theta), math.sin(theta), 0.0, angle, 0.0)
        travel += abs(joint.target - angle)
        angle = joint.target
    assert math.degrees(travel / n) <= 48.04 * 1.01


@pytest.mark.parametrize(("start", "goal"), [(0.0, 2.0), (2.5, -1.0), (0.0, 0.01), (1.0, 1.0001)])
def test_motion_keeps_rate_and_rate_change_without_overshoot(start: float, goal: float) -> None:
    joint = turned(steering(), start)
    joint.target = goal
    dt, before, rate = 0.02, start, 0.0
    ticks = 0
    while joint.angle != goal or joint.rate != 0.0:
        joint.advance(dt, 1.0)
        now = (joint.angle - before) / dt
        assert abs(now) <= 4.0 + 1e-9
        assert abs(now - rate) <= 20.0 * dt + 1e-6
        assert min(start, goal) - 1e-9 <= joint.angle <= max(start, goal) + 1e-9
        before, rate = joint.angle, now
        ticks += 1
        assert ticks < 200
    # The shortest time is distance / rate + rate / change.
    assert ticks * dt <= abs(goal - start) / 4.0 + 4.0 / 20.0 + 4 * dt


@pytest.mark.parametrize("side", [0.0, -0.0])
def test_of_two_equal_turns_the_positive_one_is_chosen(side: float) -> None:
    """Half a turn to either side takes less time than reversing a fast wheel."""
    joint = steering((-4.0, 4.0), hysteresis=0.0)
    joint.acceleration = 0.1
    joint.reset(0.0)
    joint.choose(1.0, 0.0, 0.0, 0.0, 1.0)
    joint.choose(-1.0, side, 0.0, 0.0, 1.0)
    assert (joint.target, joint.direction) == (math.pi, 1.0)


def test_a_joint_that_cannot_stop_before_its_limit_rests_there() -> None:
    joint = SteeringJoint([wheel("w", 0.0, 0.0, "steered", limits=(-0.7, 0.7))], (0,), 0.02)
    joint.reset(0.69)
    joint.rate = 3.0
    joint.advance(0.02, 1.0)
    assert (joint.angle, joint.rate) == (0.7, 0.0)


def test_a_reset_forgets_an_unreachable_motion_and_resume_keeps_it() -> None:
    limits = (-0.7, 0.7)
    joint = turned(steering(limits), 0.1)
    joint.choose(0.0, 1.0, 0.0, 0.1, 0.0)
    other = steering(limits)
    other.resume(joint)
    assert other.unreachable
    joint.reset(0.1)
    assert not joint.unreachable
    other.resume(joint)
    assert not other.unreachable
    joint.choose(0.0, 1.0, 0.0, 0.1, 0.0)
    assert joint.unreachable


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 2])
@pytest.mark.parametrize("phi", [-2.9, -1.0, 0.3, 1.4, 3.0])
def test_a_steering_axis_without_limits_never_unwinds(turns: int, phi: float) -> None:
    """After any number of turns, the joint is at most a quarter turn from its next angle."""
    angle = 0.5 + 2.0 * math.pi * turns
    joint = turned(steering((None, None)), angle)
    assert joint.angle == angle
    joint.choose(math.cos(phi), math.sin(phi), 0.0, angle, 0.0)
    assert abs(joint.target - angle) <= math.pi / 2 + 0.02
    assert joint.direction * math.cos(joint.target - phi) == pytest.approx(1.0)
    for _ in range(500):
        joint.advance(0.02, 1.0)
    assert joint.angle == pytest.approx(joint.target)
    assert not joint.unreachable


def test_a_wheel_without_limits_that_rotates_with_its_direction_goes_on_past_a_turn() -> None:
    joint = turned(steering((None, None)), 0.0)
    angle = 0.0
    for k in range(1, 200):
        phi = 0.1 * k
        joint.choose(math.cos(phi), math.sin(phi), 0.0, angle, 1.0)
        angle = joint.target
        assert angle == pytest.approx(phi)
        assert joint.direction == 1.0
