"""Set-points of a CiA 402 drive in each mode, in time steps that the tests choose."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from thorvaldc.can.canopen import Mode
from thorvaldc.simulation.bus.cia402_motion import Bounds, Homing, Motion, Move, ramp

DT = 1 / 64
BOUNDS = Bounds(-2.0, 3.0, 1.0, 2.0, 4.0)
FREE = Bounds(-math.inf, math.inf, 1.0, 2.0, 4.0)
START, IMMEDIATELY, RELATIVE, HALT = 1 << 4, 1 << 5, 1 << 6, 1 << 8


def test_ramp() -> None:
    assert [ramp(0.0, goal, 2.0, 0.25) for goal in (0.25, 0.5, 3.0)] == [0.25, 0.5, 0.5]
    assert [ramp(1.0, goal, 2.0, 0.25) for goal in (-1.0, 0.75)] == [0.5, 0.75]


@pytest.mark.parametrize("goal", [2.0, -2.0])
@pytest.mark.parametrize("speed", [0.0, 0.5, -0.5, 3.0])
def test_a_move_keeps_its_limits_and_ends_at_rest(goal: float, speed: float) -> None:
    move = Move(0.0, speed)
    positions, speeds, arrived = [0.0], [speed], False
    while not arrived:
        arrived = move.step(goal, 1.0, 2.0, 4.0, DT)
        positions.append(move.position)
        speeds.append(move.speed)
        assert len(speeds) < 400
    assert (move.position, move.speed) == (goal, 0.0)
    for before, after in pairwise(speeds[:-1]):
        rate = (after - before) / DT
        speeding_up = before * after >= 0.0 and abs(after) > abs(before)
        assert abs(rate) <= (2.0 if speeding_up else 4.0) * 1.02
    direction = math.copysign(1.0, goal)
    assert max(direction * v for v in speeds) == pytest.approx(max(1.0, direction * speed))
    if abs(speed) < 1.0:
        assert max(direction * p for p in positions) == pytest.approx(abs(goal)), "no overshoot"
    # Acceleration from rest to 1 m/s, constant speed, deceleration.
    if speed == 0.0:
        assert len(speeds) * DT == pytest.approx(0.5 + 0.25 + (2.0 - 0.25 - 0.125), abs=3 * DT)


def profile(motion: Motion, target: float, bounds: Bounds = BOUNDS, limit: int = 600) -> int:
    """Runs until the set-point rests; returns the number of steps."""
    for steps in range(1, limit):
        motion.profile_position(target, bounds, DT)
        if motion.move.speed == 0.0:
            return steps
    raise AssertionError("the set-point does not rest")


def test_a_new_set_point_needs_a_rising_edge() -> None:
    motion = Motion()
    motion.rest(0.0, Mode.PROFILE_POSITION)
    profile(motion, 1.0)
    assert motion.move.position == 0.0
    motion.control(START)
    assert not motion.acknowledged
    motion.profile_position(1.0, BOUNDS, DT)
    assert motion.acknowledged
    motion.control(START)
    profile(motion, 2.0)
    assert motion.move.position == 1.0
    motion.control(0)
    assert not motion.acknowledged
    profile(motion, 2.0)
    assert motion.move.position == 1.0


def test_a_relative_target_starts_at_the_last_goal() -> None:
    motion = Motion()
    motion.rest(0.5, Mode.PROFILE_POSITION)
    for goal in (1.0, 1.5):
        motion.control(0)
        motion.control(START | RELATIVE)
        profile(motion, 0.5)
        assert motion.move.position == goal
    motion.control(0)
    motion.control(START)
    profile(motion, 0.5)
    assert motion.move.position == 0.5


def test_a_second_target_waits_or_takes_effect_immediately() -> None:
    motion = Motion()
    motion.rest(0.0, Mode.PROFILE_POSITION)
    motion.control(START)
    for _ in range(30):
        motion.profile_position(2.0, BOUNDS, DT)
    motion.control(0)
    motion.control(START)
    motion.profile_position(-1.0, BOUNDS, DT)
    motion.control(0)
    assert motion.acknowledged, "the set-point waits"
    positions = []
    for _ in range(600):
        motion.profile_position(-1.0, BOUNDS, DT)
        positions.append(motion.move.position)
    assert max(positions) == 2.0
    assert positions[-1] == -1.0
    motion.control(START)
    for _ in range(30):
        motion.profile_position(2.0, BOUNDS, DT)
    motion.control(0)
    motion.control(START | IMMEDIATELY)
    motion.profile_position(-1.0, BOUNDS, DT)
    motion.control(IMMEDIATELY)
    assert not motion.acknowledged
    for _ in range(600):
        motion.profile_position(-1.0, BOUNDS, DT)
        assert motion.move.position < 0.0
    assert motion.move.position == -1.0


@pytest.mark.parametrize(
    ("target", "goal", "limited"), [(3.0, 3.0, False), (3.1, 3.0, True), (-9.0, -2.0, True)]
)
def test_a_target_beyond_a_limit(target: float, goal: float, limited: bool) -> None:
    motion = Motion()
    motion.rest(0.0, Mode.PROFILE_POSITION)
    motion.control(START)
    profile(motion, target)
    assert (motion.move.position, motion.limited) == (goal, limited)
    motion.stop(1.0, DT)
    assert not motion.limited


def test_halt_stops_with_the_deceleration_and_counts_as_reached() -> None:
    motion = Motion()
    motion.rest(0.0, Mode.PROFILE_POSITION)
    motion.control(START)
    for _ in range(60):
        motion.profile_position(2.0, BOUNDS, DT)
    assert motion.move.speed == 1.0
    start = motion.move.position
    motion.control(START | HALT)
    steps = 0
    while motion.move.speed > 0.0:
        assert not motion.reached
        motion.profile_position(2.0, BOUNDS, DT)
        motion.settle(motion.move.position, 9.0, 0.0, DT)
        steps += 1
    assert steps == 16
    assert motion.reached
    assert motion.move.position - start == pytest.approx(0.125, abs=DT)
    motion.control(START)
    profile(motion, 2.0)
    assert motion.move.position == 2.0


def test_the_target_is_reached_after_the_time_in_the_window() -> None:
    motion = Motion()
    motion.rest(1.0, Mode.PROFILE_POSITION)
    motion.settle(1.2, 0.1, 0.0, 0.25)
    assert not motion.reached
    for position in (1.125, 0.875):
        for seconds in (0.25, 0.5, 0.75):
            motion.settle(position, 0.125, 0.75, 0.25)
            assert motion.reached is (seconds == 0.75)
        motion.settle(2.0, 0.125, 0.75, 0.25)
        assert not motion.reached
    motion.control(START)
    motion.profile_position(2.0, BOUNDS, DT)
    motion.control(0)
    motion.control(START)
    motion.profile_position(2.5, BOUNDS, DT)
    motion.settle(2.0, 0.125, 0.0, 0.25)
    assert not motion.reached, "a target waits"


@pytest.mark.parametrize(
    ("target", "position", "allowed", "limited"),
    [
        (0.5, 0.0, 0.5, False),
        (-1.5, 0.0, -1.0, True),
        (1.5, 0.0, 1.0, True),
        (1.0, 2.875, 1.0, False),  # sqrt(2 * 4 * 0.125)
        (1.0, 2.96875, 0.5, True),
        (-1.0, -1.96875, -0.5, True),
        (-1.0, 2.96875, -1.0, False),
        (1.0, 3.0, 0.0, True),
        (1.0, 3.5, 0.0, True),
        (-0.5, -2.5, 0.0, True),
    ],
)
def test_speed_within_its_limits(
    target: float, position: float, allowed: float, limited: bool
) -> None:
    motion = Motion()
    motion.rest(position, Mode.PROFILE_VELOCITY)
    assert motion.velocity(target, position, BOUNDS, 10.0) == allowed
    assert motion.limited is limited
    assert motion.move.speed == allowed
    assert motion.move.position == position
    assert motion.velocity(target, position, FREE, 10.0) == min(max(target, -1.0), 1.0)


def test_speed_ramps_and_halt() -> None:
    motion = Motion()
    motion.change(Mode.PROFILE_VELOCITY, 0.0, 0.25)
    motion.velocity(1.0, 0.0, FREE, 0.125)
    assert motion.move.speed == 0.5
    motion.velocity(0.0, 0.0, FREE, 0.0625)
    assert motion.move.speed == 0.25
    motion.control(HALT)
    assert motion.velocity(1.0, 0.0, FREE, 1.0) == 0.0
    motion.change(Mode.CYCLIC_VELOCITY, 0.0, 0.0)
    assert motion.velocity(1.0, 0.0, FREE, 1.0) == 1.0


def test_cyclic_position_interpolates() -> None:
    motion = Motion()
    motion.rest(0.0, Mode.CYCLIC_POSITION)
    positions = []
    for target in (0.0625, 0.125):
        for _ in range(4):
            motion.cyclic_position(target, BOUNDS, 0.25, 0.0625)
            positions.append(motion.move.position)
            assert motion.move.speed == 0.25
    assert positions == [k / 64 for k in range(1, 9)]
    motion.cyclic_position(0.125, BOUNDS, 0.25, 0.0625)
    assert (motion.move.position, motion.move.speed, motion.limited) == (0.125, 0.0, False)


@pytest.mark.parametrize(
    ("target", "step", "limited"),
    [
        (0.25, 0.0625, False),
        (0.3, 0.0625, True),  # faster than 1 rad/s
        (-0.3, -0.0625, True),
        (5.0, 0.0625, True),
    ],
)
def test_cyclic_position_is_limited(target: float, step: float, limited: bool) -> None:
    motion = Motion()
    motion.rest(0.0, Mode.CYCLIC_POSITION)
    motion.cyclic_position(target, BOUNDS, 0.25, 0.0625)
    assert (motion.move.position, motion.limited) == (step, limited)
    motion.rest(2.9375, Mode.CYCLIC_POSITION)
    motion.cyclic_position(3.01, BOUNDS, 0.25, 0.25)
    assert (motion.move.position, motion.limited) == (3.0, True)


@pytest.mark.parametrize("method", [35, 37])
def test_homing_at_the_present_position(method: int) -> None:
    homing = Homing(method)
    assert homing.attained
    assert homing.speed((False, False), 0.0, 1.0, 0.5, DT) == 0.0


@pytest.mark.parametrize("method", [0, 1, 36, 19, -3])
def test_unknown_homing(method: int) -> None:
    homing = Homing(method)
    assert homing.failed
    assert not homing.attained
    assert homing.speed((True, True), 0.0, 1.0, 0.5, DT) == 0.0


@pytest.mark.parametrize(
    ("method", "direction", "on", "other"),
    [(17, -1.0, (True, False), (False, True)), (18, 1.0, (False, True), (True, False))],
)
def test_homing_at_a_switch(
    method: int, direction: float, on: tuple[bool, bool], other: tuple[bool, bool]
) -> None:
    homing = Homing(method)
    assert homing.speed((False, False), 0.0, 1.0, 0.25, DT) == direction
    assert homing.speed(other, direction, 1.0, 0.25, DT) == direction
    assert homing.speed(on, direction, 1.0, 0.25, DT) == -0.25 * direction
    assert not homing.attained
    assert homing.speed(on, -0.25 * direction, 1.0, 0.25, DT) == -0.25 * direction
    assert homing.speed(other, -0.25 * direction, 1.0, 0.25, DT) == 0.0
    assert homing.attained
    assert not homing.failed


@pytest.mark.parametrize(("method", "direction"), [(-1, -1.0), (-2, 1.0)])
def test_homing_at_a_mechanical_stop(method: int, direction: float) -> None:
    homing = Homing(method)
    for _ in range(3):  # the motor stands before it starts: 0.2 s at the slow speed
        assert homing.speed((True, True), 0.0, 1.0, 0.25, 0.0625) == 0.25 * direction
    assert homing.speed((True, True), 0.02, 1.0, 0.25, 0.0625) == 0.25 * direction
    assert homing.speed((True, True), 0.03, 1.0, 0.25, 0.0625) == 0.25 * direction
    assert homing.speed((True, True), -0.02, 1.0, 0.25, 0.0625) == 0.25 * direction
    assert homing.speed((True, True), 0.02, 1.0, 0.25, 0.0625) == 0.0
    assert homing.attained


@pytest.mark.parametrize("method", [17, -1])
def test_homing_fails_after_two_and_a_half_turns(method: int) -> None:
    homing = Homing(method)
    speed = 1.0 if method == 17 else 0.25
    steps = 0
    while homing.speed((False, False), -speed, 1.0, 0.25, 0.0625):
        steps += 1
        assert not homing.failed
    assert homing.failed
    assert steps == int(5.0 * math.pi / (speed * 0.0625))
