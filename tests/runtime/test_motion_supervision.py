"""Measured motion of a motor beside its target: what deviates, and for how long it may."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tests.simulation.bus.robots import cia402
from thorvaldc.runtime.motion_supervision import (
    REST_TRAVEL,
    STOP_SHARE,
    Axis,
    Follower,
    FollowLimits,
    Obedience,
    Stopper,
    obedience,
)

PER_SECOND = 64
PERIOD = 1 / PER_SECOND  # s; sums of it are exact


def make_axis(role: str) -> Axis:
    actuator = next(a for a in cia402().actuators if a.role == role)
    return Axis(actuator, 0, role)


class Cycles:
    """Control cycles with the same measured velocity until the next change."""

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.follower = Follower(axis)
        self.problem = ""
        self.now = 0.0

    @property
    def deviates(self) -> bool:
        return self.follower.deviating_since < math.inf

    def run(self, seconds: float, velocity: float, target: float, position: float = 0.0) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += PERIOD
            self.axis.target = target
            self.axis.update(self.now, position, velocity)
            self.axis.follows = True
            self.problem = self.follower.problem(self.now)

    def pause(self) -> None:
        self.axis.follows = False
        self.problem = self.follower.problem(self.now)


@pytest.mark.parametrize(
    ("velocity", "target", "deviates"),
    [
        (0.0, 0.3, False),
        (0.0, 0.35, True),
        (0.0, -0.35, True),
        (2.1, 4.0, False),
        (1.9, 4.0, True),
        (5.9, 4.0, False),
        (6.1, 4.0, True),
        (-2.1, -4.0, False),
        (-1.9, -4.0, True),
        (-6.1, -4.0, True),
        (4.0, -4.0, True),
    ],
)
def test_a_wheel_may_deviate_by_half_of_its_target(
    velocity: float, target: float, deviates: bool
) -> None:
    cycles = Cycles(make_axis("propulsion"))
    cycles.run(0.1, velocity, target)
    assert cycles.deviates is deviates
    assert cycles.problem == ""
    cycles.run(1.0, velocity, target)
    expected = "the propulsion does not follow its target" if deviates else ""
    assert cycles.problem == expected


def test_a_wheel_may_be_between_its_targets_of_half_a_second() -> None:
    cycles = Cycles(make_axis("propulsion"))
    cycles.run(1.0, 0.0, 0.0)
    cycles.run(0.5, 0.0, 4.0)
    assert not cycles.deviates
    cycles.run(PERIOD, 0.0, 4.0)
    assert cycles.deviates
    cycles.run(PERIOD, 4.0, 4.0)
    assert not cycles.deviates


def test_targets_before_a_pause_do_not_count() -> None:
    cycles = Cycles(make_axis("propulsion"))
    cycles.run(0.25, 4.0, 4.0)
    cycles.pause()
    assert not cycles.deviates
    cycles.run(PERIOD, 4.0, 1.0)
    assert cycles.deviates
    cycles.pause()
    assert not cycles.deviates


def test_a_wheel_that_rolled_without_torque_brakes_first() -> None:
    """After a power cut the wheels roll while the robot starts."""
    axis = make_axis("propulsion")
    cycles, speed = Cycles(axis), 4.0
    while speed > 0.0:
        cycles.run(PERIOD, speed, 0.0)
        speed -= STOP_SHARE * axis.actuator.max_acceleration * PERIOD
    cycles.run(1.0, 0.0, 0.0)
    assert cycles.problem == ""
    rolling = Cycles(make_axis("propulsion"))
    rolling.run(3.0, 4.0, 0.0)
    assert rolling.problem != ""


@pytest.mark.parametrize(
    ("position", "velocity", "deviates"),
    [(0.81, 0.0, False), (0.79, 0.0, True), (1.21, -0.019, True), (0.0, 0.03, False)],
)
def test_a_steering_joint_that_stands_must_be_at_its_target(
    position: float, velocity: float, deviates: bool
) -> None:
    cycles = Cycles(make_axis("steering"))
    cycles.run(0.5 + PERIOD, velocity, 1.0, position)
    assert cycles.deviates is deviates
    assert cycles.problem == ""
    cycles.run(PERIOD, velocity, 1.0, position)
    assert bool(cycles.problem) is deviates


def test_a_kerb_may_turn_a_wheel_a_little() -> None:
    cycles = Cycles(make_axis("propulsion"))
    cycles.run(1.0, 0.3, 0.3)
    cycles.run(0.3, -0.9, 0.3)
    assert cycles.deviates
    assert cycles.problem == ""
    cycles.run(0.25, -0.9, 0.3)
    assert cycles.problem != ""


@pytest.mark.parametrize("velocity", [0.5, -0.5])
def test_a_steering_joint_may_turn_only_towards_its_target(velocity: float) -> None:
    cycles = Cycles(make_axis("steering"))
    cycles.run(0.5 + 2 * PERIOD, velocity, 1.0, 0.5)
    assert bool(cycles.problem) is (velocity < 0.0)


def swing(cycles: Cycles, centre: float, angle: float, seconds: float) -> float:
    """Lets a joint swing by ``angle`` (deg) about ``centre`` with 1 rad/s; its target is 0.

    Returns the time (s) of the problem, or NaN.
    """
    middle, position, velocity = math.radians(centre), math.radians(centre), 1.0
    end = cycles.now + seconds
    while cycles.now < end:
        position += velocity * PERIOD
        if abs(position - middle) > math.radians(angle):
            velocity = math.copysign(1.0, middle - position)
        cycles.run(PERIOD, velocity, 0.0, position)
        if cycles.problem:
            return cycles.now
    return math.nan


def test_a_steering_joint_may_not_swing_about_another_angle() -> None:
    """It turns towards its target half of the time, so that no deviation lasted."""
    cycles = Cycles(make_axis("steering"))
    assert swing(cycles, 12.0, 12.0, 10.0) < 2.5
    assert cycles.problem == "the steering swings about another angle than its target"


def test_a_steering_joint_may_swing_a_little_and_follow_a_stick() -> None:
    cycles = Cycles(make_axis("steering"))
    assert math.isnan(swing(cycles, 1.0, 4.0, 30.0))
    position = target = 0.0
    for k in range(3000):  # a stick from side to side, and a joint that is 0.1 s late
        target = 0.6 * math.sin(4.0 * k * PERIOD)
        late = 0.6 * math.sin(4.0 * (k * PERIOD - 0.1))
        cycles.run(PERIOD, (late - position) / PERIOD, target, late)
        position = late
        assert cycles.problem == ""


def test_a_wheel_that_stands_by_command_may_not_travel() -> None:
    cycles = Cycles(make_axis("propulsion"))
    cycles.run(0.9 * REST_TRAVEL / 0.25, 0.25, 0.0)
    assert cycles.problem == ""
    cycles.run(PERIOD, 0.0, 0.0)
    cycles.run(0.9 * REST_TRAVEL / 0.25, 0.25, 0.0)
    assert cycles.problem == "", "the wheel stood in between"
    cycles.run(0.2 * REST_TRAVEL / 0.25, 0.25, 0.0)
    assert cycles.problem == "the propulsion turns, although it is commanded to stand"


@pytest.mark.parametrize(
    ("change", "moves", "problem"), [(0.2, 0.0, 0), (0.5, 0.0, 1), (0.5, 1e-6, 0)]
)
def test_reports_that_do_not_change_while_the_target_does(
    change: float, moves: float, problem: int
) -> None:
    cycles = Cycles(make_axis("propulsion"))
    cycles.run(1.0, 4.0, 4.0)
    cycles.run(0.25, 4.0 + moves, 4.0 + change)
    cycles.run(0.5, 4.0 + 2.0 * moves, 4.0 + change)
    assert bool(cycles.problem) is bool(problem)
    if problem:
        assert cycles.problem.endswith("its reports do not change")


def test_a_wheel_that_stands_before_its_target_does_is_not_frozen() -> None:
    cycles = Cycles(make_axis("propulsion"))
    cycles.run(PERIOD, 0.0, 0.6)
    cycles.run(0.4, 0.0, 0.31)
    cycles.run(3.0, 0.0, 0.0)
    assert cycles.problem == ""


def test_a_driver_can_only_be_stricter() -> None:
    strict = FollowLimits(0.25, 2.0, 1.0, 0.1, 3.0, 0.4)
    assert FollowLimits().stricter(strict) == FollowLimits(0.25, 1.0, 0.3, 0.1, 0.3, 0.2)


class Stop:
    """A motor that is commanded to stop, with the velocity as a function of time."""

    def __init__(self, role: str = "propulsion") -> None:
        self.axis = make_axis(role)
        self.rate = self.axis.actuator.max_acceleration

    def judge(self, seconds: float, velocity: Callable[[float], float]) -> Obedience:
        stopper = Stopper(self.axis)
        self.axis.update(0.0, 0.0, velocity(0.0))
        stopper.begin(0.0, 0.05)
        now, answer = 0.0, Obedience.UNKNOWN
        while now < seconds:
            now += PERIOD
            self.axis.update(now, 0.0, velocity(now))
            answer = obedience([stopper], now)
        return answer


@pytest.mark.parametrize("role", ["propulsion", "steering"])
@pytest.mark.parametrize(
    ("share", "expected"),
    [(1.0, Obedience.SLOWS), (0.55, Obedience.SLOWS), (0.3, Obedience.DISOBEYS),
     (0.0, Obedience.DISOBEYS), (-0.2, Obedience.DISOBEYS)],
)  # fmt: skip
def test_a_motor_slows_down_as_promised(role: str, share: float, expected: Obedience) -> None:
    stop = Stop(role)
    top = 1.5 * stop.rate
    assert stop.judge(1.0, lambda now: top - share * stop.rate * now) is expected


def test_a_motor_that_ignores_a_stop_is_noticed_at_once() -> None:
    stop = Stop()
    assert stop.judge(0.2, lambda now: 4.0) is Obedience.SLOWS, "the reaction takes time"
    assert stop.judge(0.45, lambda now: 4.0) is Obedience.DISOBEYS


def test_a_motor_stands_or_creeps_at_the_end_of_a_stop() -> None:
    stop = Stop()
    assert stop.judge(3.0, lambda now: max(4.0 - 4.0 * now, 0.0)) is Obedience.STANDS
    assert stop.judge(3.0, lambda now: max(4.0 - 4.0 * now, 0.1)) is Obedience.SLOWS
    assert stop.judge(10.0, lambda now: max(4.0 - 4.0 * now, 0.1)) is Obedience.DISOBEYS


def test_a_motor_without_reports_is_unknown() -> None:
    axis = make_axis("propulsion")
    stopper = Stopper(axis)
    axis.update(0.0, 0.0, 0.0)
    stopper.begin(0.0, 0.05)
    assert obedience([stopper], 0.15) is Obedience.STANDS
    assert obedience([stopper], 0.25) is Obedience.UNKNOWN


def test_velocity_from_positions() -> None:
    axis = make_axis("propulsion")
    axis.update(1.0, 2.0)
    assert axis.velocity == 0.0
    axis.update(1.5, 3.0)
    assert axis.velocity == 2.0
    axis.update(1.5, 3.5)
    assert axis.velocity == 0.0
    axis.update(2.5, 9.0)  # too long ago
    assert axis.velocity == 0.0
    axis.update(2.75, 8.0)
    assert (axis.time, axis.position, axis.velocity) == (2.75, 8.0, -4.0)


@pytest.mark.parametrize(("seconds", "counted"), [(0.02, 0.04), (0.04, 0.04), (0.5, 0.5)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_jump_of_a_steering_angle(seconds: float, counted: float, sign: float) -> None:
    """The joint may turn 1.5 times as fast as its motor for at least 0.04 s, and 0.1 rad more."""
    for excess, homed, jumps in ((-1e-6, True, False), (1e-6, True, True), (1.0, False, False)):
        axis = make_axis("steering")
        assert math.isnan(axis.position)
        axis.homed = homed
        change = 1.5 * axis.actuator.max_velocity * counted + 0.1 + excess
        axis.update(1.0, 0.2, 0.0)
        axis.update(1.0 + seconds, 0.2 + sign * change, 0.0)
        assert axis.jump == pytest.approx(change if jumps else 0.0)
        if jumps:  # the first jump is kept
            axis.update(2.0, 0.2 + 3.0 * sign * change, 0.0)
            assert axis.jump == pytest.approx(change)


def test_a_wheel_has_no_jump() -> None:
    axis = make_axis("propulsion")
    axis.update(1.0, 0.0, 0.0)
    axis.update(1.02, 100.0, 0.0)
    assert axis.jump == 0.0


def test_a_restart_loses_the_reference_of_steering_only() -> None:
    for role, homed in (("propulsion", True), ("steering", False)):
        axis = make_axis(role)
        axis.homed, axis.target = True, 1.5
        axis.lose_reference()
        assert (axis.homed, axis.target) == (homed, 0.0)


# -- reports that no motion explains -------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "share", "jumps"),
    [(5.0, 0.3, True), (1.5, 0.3, True), (0.3, 0.3, False), (5.0, 1 / PER_SECOND, False)],
)
@pytest.mark.parametrize("target", [0.0, 4.0])
def test_wrong_speeds_in_some_reports(
    wrong: float, share: float, jumps: bool, target: float
) -> None:
    """One wrong report a second is none of these."""
    cycles, number = Cycles(make_axis("propulsion")), 0.0
    cycles.run(1.0, target, target)
    while cycles.now < 20.0 and not cycles.problem:
        number += share
        is_wrong = number >= 1.0
        number -= is_wrong
        cycles.run(PERIOD, target + wrong * is_wrong, target)
    assert ("jumps, as no wheel can" in cycles.problem) is jumps
    if jumps:
        assert cycles.now < 1.6


def test_jumps_are_forgotten_after_a_few_seconds() -> None:
    axis = make_axis("propulsion")
    cycles = Cycles(axis)
    for k in range(1000):
        cycles.run(PERIOD, 5.0 * (k % 2), 0.0)
    assert cycles.problem
    cycles.run(5.0, 0.0, 0.0)
    assert cycles.problem == ""


def test_a_wheel_that_is_blocked_does_not_jump() -> None:
    cycles = Cycles(make_axis("propulsion"))
    for _ in range(10):
        cycles.run(0.5, 4.0, 4.0)
        cycles.run(0.5, 0.0, 4.0)
        assert "jumps" not in cycles.problem
