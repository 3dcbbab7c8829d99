"""The reachable twist of robots with fixed wheels and steering limits."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.base_geometry import FixedWheels
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.calculators.reachable_twists import ReachableTwists
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

SQUARE = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]


def steered(limit: float, *, trail: float = 0.0) -> list[WheelGeometry]:
    """Four steered wheels with limits of +-``limit`` deg."""
    bound = math.radians(limit)
    return [
        wheel(f"w{i}", x, y, "steered", limits=(-bound, bound), trail=trail)
        for i, (x, y) in enumerate(SQUARE)
    ]


def car(limit: float) -> list[WheelGeometry]:
    """A car with steered front wheels and fixed rear wheels, limits of +-``limit`` deg."""
    front = steered(limit)[:2]
    return front + [wheel(f"w{i}", *SQUARE[i], "fixed") for i in (2, 3)]


def reachable(wheels: list[WheelGeometry]) -> ReachableTwists:
    return ReachableTwists(BaseGeometry.from_wheels(wheels), FixedWheels(wheels))


def exists(w: WheelGeometry, twist: Twist) -> bool:
    """Samples the side slip within the limits; without slip at any angle, its sign is constant."""
    assert w.lower is not None
    assert w.upper is not None

    def slip(angle: float) -> float:
        return sum(a * b for a, b in zip(w.rows(angle)[1], twist, strict=True))

    n = 300
    samples = [slip(w.lower + (w.upper - w.lower) * k / n) for k in range(n + 1)]
    return min(samples) <= 1e-4 and max(samples) >= -1e-4


def test_car_turns_as_tightly_as_the_inner_wheel_can_steer() -> None:
    calculator = General(BaseGeometry.from_wheels(car(35.0)))
    easy = calculator.command(Twist(0.8, 0.55 * 0.3, 0.3))
    assert easy.target == Twist(0.8, 0.55 * 0.3, 0.3)
    assert easy.unreachable == ()
    for sign in (1.0, -1.0):
        calculator.reset()
        command = calculator.command(Twist(0.8, 0.0, 0.42 * sign))
        # The inner front wheel is 1.1 m in front of the axle and 0.45 m from its middle.
        radius = 0.45 + 1.1 / math.tan(math.radians(35.0))
        expected = Twist(0.8, 0.55 * 0.8 / radius * sign, 0.8 / radius * sign)
        assert command.target == pytest.approx(expected, abs=1e-12)
        assert command.infeasible.wz == pytest.approx(sign * (0.42 - 0.8 / radius))
        assert max(map(abs, command.joints.angles)) == pytest.approx(math.radians(35.0))
        assert command.unreachable == ((0,) if sign > 0 else (1,))
        states = JointStates(0.0, command.joints.speeds, command.joints.angles, [0.0] * 4)
        assert calculator.odometry(states).twist == pytest.approx(command.twist, abs=1e-9)


def test_car_stands_when_it_is_to_turn_on_the_spot() -> None:
    command = General(BaseGeometry.from_wheels(car(35.0))).command(Twist(0.0, 0.0, 0.5))
    assert command.target == ZERO_TWIST
    assert not any(command.joints.speeds)
    assert command.infeasible == Twist(0.0, 0.0, 0.5)
    assert command.unreachable == (0, 1)


def test_four_limited_wheels_keep_their_speed_in_a_tight_turn() -> None:
    twists = reachable(steered(40.0))
    radius = 0.45 + 0.55 / math.tan(math.radians(40.0))
    assert twists.feasible(Twist(0.8, 0.0, 1.4)) == pytest.approx((0.8, 0.0, 0.8 / radius))
    assert twists.feasible(Twist(-0.8, 0.0, 1.4)) == pytest.approx((-0.8, 0.0, 0.8 / radius))


@pytest.mark.parametrize(("direction", "deviation"), [(50, 10), (84, 44), (86, 45), (90, 45)])
def test_sideways_motion_turns_by_less_than_45_degrees(direction: int, deviation: int) -> None:
    """From 45 deg beside the nearest reachable direction on, the robot stands."""
    commanded, share = math.radians(direction), math.cos(2.0 * math.radians(deviation))
    limit = math.radians(40.0)
    for sign in (1.0, -1.0):
        twist = Twist(sign * 0.5 * math.cos(commanded), 0.5 * math.sin(commanded), 0.0)
        target = reachable(steered(40.0)).feasible(twist)
        expected = (sign * 0.5 * share * math.cos(limit), 0.5 * share * math.sin(limit), 0.0)
        assert target == pytest.approx(expected, abs=1e-12)


def test_robot_that_can_turn_on_the_spot_slows_down_for_a_tight_turn() -> None:
    """Limits of +-60 deg: the robot can turn about points near its middle, and far from it."""
    twists = reachable(steered(60.0))
    inside = 0.45 - 0.55 / math.tan(math.radians(60.0))
    assert twists.feasible(Twist(0.06, 0.0, 0.4)) == pytest.approx((0.4 * inside, 0.0, 0.4))
    outside = 0.45 + 0.55 / math.tan(math.radians(60.0))
    assert twists.feasible(Twist(0.3, 0.0, 0.4)) == pytest.approx((0.3, 0.0, 0.3 / outside))


def test_of_two_nearly_equal_twists_the_present_one_stays() -> None:
    """A sideways command that trembles about 90 deg does not turn all wheels around."""
    twists = reachable(steered(60.0))
    twists.keep(Twist(0.1, 0.1, 0.0))
    for vx in (0.01, -0.01, 0.005, -0.005):
        assert twists.feasible(Twist(vx, 0.5, 0.0)).vx > 0.1
    twists.keep(Twist(-0.1, 0.1, 0.0))
    assert twists.feasible(Twist(0.01, 0.5, 0.0)).vx < -0.1


def test_unlimited_wheels_return_the_same_twist() -> None:
    twists = reachable(steered(90.0))
    commanded = Twist(0.1, 0.5, -0.7)
    assert twists.unlimited
    assert twists.feasible(commanded) is commanded


def test_centre_of_rotation_within_the_circle_of_a_contact_point() -> None:
    """A contact 0.1 m behind the steering axis cannot turn about a point nearer to the axis."""
    wheels = steered(360.0, trail=-0.1)
    about_axis = Twist(0.45 * 0.5, -0.55 * 0.5, 0.5)
    target = reachable(wheels).feasible(about_axis)
    assert target != about_axis
    x, y = -target.vy / target.wz, target.vx / target.wz
    assert math.hypot(x - 0.55, y - 0.45) == pytest.approx(0.1, abs=1e-9)
    assert math.hypot(x, y) == pytest.approx(math.hypot(0.55, 0.45) + 0.1)


def random_wheels(rng: random.Random) -> list[WheelGeometry]:
    limit = math.radians(rng.choice([35.0, 40.0, 60.0, 80.0, 90.0, 120.0, 180.0]))
    fixed = rng.random() < 0.4
    wheels = [
        wheel(
            f"w{i}",
            rng.uniform(0.2 if fixed else -1.0, 1.0),
            rng.uniform(-1.0, 1.0),
            "steered",
            sign=rng.choice([1.0, -1.0]),
            trail=rng.choice([0.0, rng.uniform(-0.1, 0.1)]),
            lateral=rng.choice([0.0, 0.1]),
            limits=(-limit, limit),
        )
        for i in range(rng.randint(1, 5))
    ]
    if fixed:
        wheels += [wheel(f"f{i}", -0.5, y, "fixed") for i, y in enumerate((0.4, -0.4))]
    return wheels


def test_random_twists_become_reachable_ones() -> None:
    """No wheel slips, nothing is faster than commanded, and a reachable twist does not change."""
    rng = random.Random(3)
    limited = 0
    for _ in range(80):
        wheels = random_wheels(rng)
        fixed = FixedWheels(wheels)
        for _ in range(5):
            commanded = Twist(*(rng.uniform(-1.0, 1.0) for _ in range(3)))
            twists = reachable(wheels)
            target, limiting = twists.project(commanded)
            start = fixed.feasible(commanded)
            assert fixed.feasible(target) == pytest.approx(target, abs=1e-12)
            for w in wheels:
                assert not w.steered or exists(w, target)
            assert twists.feasible(target) == pytest.approx(target, abs=1e-9)
            assert target.speed <= start.speed * (1.0 + 1e-9) + 1e-12
            assert -1e-12 <= target.wz * math.copysign(1.0, start.wz) <= abs(start.wz) + 1e-12
            assert target.vx * start.vx + target.vy * start.vy >= -1e-12
            doubled = reachable(wheels).feasible(commanded.scaled(2.0))
            assert doubled == pytest.approx(target.scaled(2.0), abs=1e-9)
            if limiting:
                limited += 1
                for i in limiting:
                    assert not exists(wheels[i], start.scaled(1e3))
            else:
                assert target == start
    assert limited > 100


def test_no_reachable_turn_is_nearer() -> None:
    """Of a fine grid of wider and slower turns, none that every wheel can make is nearer."""
    rng = random.Random(4)
    compared = 0
    for _ in range(60):
        wheels = [replace(w, trail=0.0) for w in random_wheels(rng)]
        commanded = FixedWheels(wheels).feasible(Twist(*(rng.uniform(-1.0, 1.0) for _ in range(3))))
        target, limiting = reachable(wheels).project(commanded)
        turn = FixedWheels(wheels).feasible(Twist(0.0, 0.0, commanded.wz))
        along = Twist(commanded.vx - turn.vx, commanded.vy - turn.vy, 0.0)
        if not limiting or target.wz == 0.0 or along.speed == 0.0:
            continue
        kept = target.wz / commanded.wz
        if kept > 1.0 - 1e-9:  # a slower turn
            continue
        if abs(target.vx - along.vx - kept * turn.vx) > 1e-9:  # another direction
            continue
        compared += 1
        for k in range(1, 20):
            share = kept + (1.0 - kept) * k / 20.0
            wider = Twist(along.vx + share * turn.vx, along.vy + share * turn.vy, share * turn.wz)
            assert not all(exists(w, wider) for w in wheels if w.steered)
    assert compared > 10
