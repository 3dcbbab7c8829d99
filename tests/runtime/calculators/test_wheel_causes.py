"""Wheels that slip, stall or have wrong steering angles: named, or covered by the covariance."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import numpy as np
import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, Noise, WheelGeometry
from thorvaldc.runtime.calculators.general import General, GeneralOptions
from thorvaldc.runtime.calculators.twist_estimator import (
    EstimatorOptions,
    TwistEstimate,
    TwistEstimator,
)
from thorvaldc.runtime.se2 import Cov3, Twist

FOUR = [
    wheel(f"w{i}", x, y, "steered")
    for i, (x, y) in enumerate([(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)])
]
SIX = [
    wheel(f"w{i}", x, y, "steered")
    for i, (x, y) in enumerate(
        [(1.0, 0.6), (0.9, -0.6), (0.2, 0.7), (-0.1, -0.7), (-1.0, 0.6), (-0.8, -0.6)]
    )
]
MOTIONS = [Twist(0.8, 0.0, 0.0), Twist(0.5, 0.3, 0.4), Twist(-0.3, 0.6, -0.3), Twist(0, 0, 0.7)]


def joints(
    wheels: list[WheelGeometry], twist: Twist, noise: Noise | None = None, seed: int = 1
) -> JointStates:
    """Joint states of that motion, with errors of ``noise`` or without errors."""
    rng = random.Random(seed)
    command = General(BaseGeometry.from_wheels(wheels)).command(twist)
    speeds, angles = list(command.joints.speeds), list(command.joints.angles)
    if noise is not None:
        speeds = [v * (1.0 + rng.gauss(0.0, noise.speed_ratio)) for v in speeds]
        angles = [a + rng.gauss(0.0, noise.angle) for a in angles]
    return JointStates(0.0, speeds, angles, [0.0] * len(wheels))


def with_fault(states: JointStates, i: int, wrong: str) -> JointStates:
    speeds, angles = list(states.speeds), list(states.angles)
    if wrong == "+20 deg":
        angles[i] += math.radians(20.0)
    elif wrong == "both":
        angles[i] -= math.radians(25.0)
        speeds[i] *= 1.6
    else:
        speeds[i] *= float(wrong)
    return JointStates(0.0, speeds, angles, states.angle_rates)


def estimator(wheels: list[WheelGeometry], **options: float) -> TwistEstimator:
    chosen = EstimatorOptions(**options)  # type: ignore[arg-type]
    return TwistEstimator(BaseGeometry.from_wheels(wheels), None, chosen)


def sigmas(covariance: Cov3) -> list[float]:
    return [math.sqrt(covariance[j][j]) for j in range(3)]


def squared_error(estimate: TwistEstimate, true: Twist) -> float:
    """Squared error in units of the covariance, 16.3 at its 99.9 % bound."""
    error = np.array(true) - np.array(estimate.twist)
    return float(error @ np.linalg.solve(np.array(estimate.covariance), error))


@pytest.mark.parametrize("wrong", ["1.1", "1.3", "2", "0.7", "-1", "+20 deg", "both"])
@pytest.mark.parametrize("wheels", [FOUR, SIX], ids=["4", "6"])
@pytest.mark.parametrize("motion", MOTIONS, ids=str)
def test_one_faulty_wheel_is_dropped_and_has_no_effect(
    wheels: list[WheelGeometry], motion: Twist, wrong: str
) -> None:
    states = joints(wheels, motion)
    twist_estimator = estimator(wheels)
    healthy = twist_estimator.estimate(states)
    assert healthy.dropped == ()
    assert max(healthy.chi_squares) < 1e-9
    for i in range(len(wheels)):
        estimate = twist_estimator.estimate(with_fault(states, i, wrong))
        assert estimate.dropped == (i,)
        assert estimate.chi_squares[i] == max(estimate.chi_squares)
        assert max(d for k, d in enumerate(estimate.chi_squares) if k != i) < 1e-2
        # The error of the row that is kept is within its assumed noise.
        for value, true, sigma in zip(
            estimate.twist, motion, sigmas(estimate.covariance), strict=True
        ):
            assert abs(value - true) <= 0.25 * sigma
        for value, true in zip(
            sigmas(estimate.covariance), sigmas(healthy.covariance), strict=True
        ):
            assert value >= true * 0.999


@pytest.mark.parametrize("spinning", [1, 2, 3])
def test_wheels_that_stand_while_others_turn_are_not_outvoted(spinning: int) -> None:
    """Either the encoders that read 0 are dead, or the robot is held and the others spin."""
    states = joints(FOUR, Twist(0.6, 0.0, 0.0))
    speeds = [v if i < spinning else 0.0 for i, v in enumerate(states.speeds)]
    readings = JointStates(0.0, speeds, states.angles, states.angle_rates)
    for commands in (states.speeds, None):
        estimate = estimator(FOUR).estimate(readings, commands)
        assert estimate.dropped == ()
        assert estimate.sliding == tuple(range(spinning))
        assert set(range(spinning, 4)) <= set(estimate.suspects)
        sigma = sigmas(estimate.covariance)[0]
        assert 0.0 < estimate.twist.vx < 0.6
        assert estimate.twist.vx <= 2.0 * sigma
        assert 0.6 - estimate.twist.vx <= 2.0 * sigma
        if spinning == 3 and commands:  # the example of docs/explanation/least-squares.md
            assert (estimate.twist.vx, sigma) == pytest.approx((0.58, 0.31), abs=0.005)


def test_a_gyro_decides_in_a_turn() -> None:
    motion = Twist(0.5, 0.0, 0.4)
    states = joints(FOUR, motion)
    readings = with_fault(states, 3, "0")
    readings.yaw_rate = motion.wz
    moving = estimator(FOUR).estimate(readings, states.speeds)
    assert moving.dropped == (3,)
    assert moving.twist == pytest.approx(motion, abs=0.02)
    readings.yaw_rate = 0.0
    held = estimator(FOUR).estimate(readings, states.speeds)
    assert held.dropped == ()
    assert held.sliding == (0, 1, 2)
    assert abs(held.twist.wz) < 0.01
    assert abs(held.twist.vx) <= 2.0 * sigmas(held.covariance)[0]


def test_a_gyro_that_contradicts_all_wheels_names_a_robot_that_slides() -> None:
    """All wheels spin as commanded on a robot that is held."""
    motion = Twist(0.5, 0.0, 0.4)
    states = joints(FOUR, motion)
    readings = JointStates(0.0, states.speeds, states.angles, states.angle_rates, None, 0.0)
    estimate = estimator(FOUR).estimate(readings, states.speeds)
    assert (estimate.dropped, estimate.sliding) == ((), (0, 1, 2, 3))
    assert abs(estimate.twist.vx) <= 2.0 * sigmas(estimate.covariance)[0]


SKID = [
    wheel(f"w{i}", x, y, "fixed")
    for i, (x, y) in enumerate([(0.4, 0.3), (0.4, -0.3), (-0.4, 0.3), (-0.4, -0.3)])
]


@pytest.mark.parametrize(
    ("motion", "yaw_rate"),
    [(Twist(0.5, 0.0, 0.4), 0.0), (Twist(0.5, 0.0, 0.0), 0.2), (Twist(0.0, 0.0, 0.0), 0.2)],
)
def test_a_gyro_that_contradicts_skidding_wheels(motion: Twist, yaw_rate: float) -> None:
    """A robot that is held in a turn, one that is turned, and one that is turned at rest."""
    speeds = General(BaseGeometry.from_wheels(SKID)).command(motion).joints.speeds
    readings = JointStates(0.0, speeds, [0.0] * 4, [0.0] * 4, None, yaw_rate)
    estimate = estimator(SKID).estimate(readings, speeds)
    assert (estimate.dropped, estimate.sliding) == ((), (0, 1, 2, 3))
    assert estimate.twist.wz == pytest.approx(yaw_rate, abs=0.01)
    assert abs(estimate.twist.vx) <= 2.0 * sigmas(estimate.covariance)[0]


@pytest.mark.parametrize("share", [0.8, 1.0, 1.2])
def test_a_skidding_robot_may_turn_a_little_otherwise_than_its_wheels(share: float) -> None:
    motion = Twist(0.5, 0.0, 0.4)
    speeds = General(BaseGeometry.from_wheels(SKID)).command(motion).joints.speeds
    readings = JointStates(0.0, speeds, [0.0] * 4, [0.0] * 4, None, share * motion.wz)
    estimate = estimator(SKID).estimate(readings, speeds)
    assert (estimate.dropped, estimate.suspects, estimate.sliding) == ((), (), ())
    assert estimate.twist.vx == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("yaw_rate", [0.13, -1.0])
def test_a_gyro_is_tested_although_no_wheel_fails_its_test(yaw_rate: float) -> None:
    """A robot with locked wheels is pushed: eight measurements of 0 against that of the gyro."""
    readings = JointStates(0.0, [0.0] * 4, [0.0] * 4, [0.0] * 4, None, yaw_rate)
    estimate = estimator(FOUR).estimate(readings, [0.0] * 4)
    assert estimate.sliding == (0, 1, 2, 3)
    assert squared_error(estimate, Twist(0.3, -0.3, yaw_rate)) < 16.3


def test_a_small_contradiction_of_a_gyro_shows_a_slide_too() -> None:
    """Two wheels spin as commanded on a body that is held."""
    wheels = [wheel(f"w{i}", 0.0, y, "fixed") for i, y in enumerate((0.4, -0.4))]
    speeds = [0.173 / 0.2, 0.206 / 0.2]
    readings = JointStates(0.0, speeds, [0.0] * 2, [0.0] * 2, None, 0.0)
    estimate = estimator(wheels).estimate(readings, speeds)
    assert estimate.sliding == (0, 1)
    assert squared_error(estimate, Twist(0.0, 0.0, 0.0)) < 16.3


def test_a_pull_may_be_faster_than_the_wheels() -> None:
    wheels = [wheel(f"w{i}", 0.0, y, "fixed") for i, y in enumerate((0.4, -0.4))]
    speeds = [0.15 / 0.2] * 2
    readings = JointStates(0.0, speeds, [0.0] * 2, [0.0] * 2, None, 0.1)
    estimate = estimator(wheels).estimate(readings, speeds)
    assert squared_error(estimate, Twist(-0.85, 0.0, 0.1)) < 16.3


@pytest.mark.parametrize("wheels", [FOUR, SIX], ids=["4", "6"])
@pytest.mark.parametrize("share", [0.95, 1.05])
def test_all_wheels_but_one_may_have_a_wrong_radius(
    wheels: list[WheelGeometry], share: float
) -> None:
    """The majority follows its commands and agrees, and is wrong by five standard deviations."""
    for motion in (Twist(1.2, 0.0, 0.0), Twist(0.8, 0.3, 0.2)):
        speeds = [share * v for v in joints(wheels, motion).speeds]
        speeds[1] /= share
        readings = JointStates(0.0, speeds, joints(wheels, motion).angles, [0.0] * len(wheels))
        estimate = estimator(wheels).estimate(readings, speeds)
        assert estimate.dropped or estimate.suspects
        assert squared_error(estimate, motion) < 16.3


def test_a_gyro_shows_that_all_radii_are_wrong() -> None:
    motion = Twist(0.1, 0.1, -0.52)
    states = joints(FOUR, motion)
    speeds = [0.95 * v for v in states.speeds]
    readings = JointStates(0.0, speeds, states.angles, states.angle_rates, None, motion.wz)
    estimate = estimator(FOUR).estimate(readings, speeds)
    assert set(estimate.suspects) == set(range(4))
    assert squared_error(estimate, motion) < 16.3


@pytest.mark.parametrize("share", [0.4, 0.8])
def test_a_wheel_that_is_a_little_slower_does_not_show_how_far_the_robot_slides(
    share: float,
) -> None:
    states = joints(SIX, Twist(0.5, 0.0, 0.4))
    readings = with_fault(states, 5, str(share))
    estimate = estimator(SIX).estimate(readings, states.speeds)
    assert squared_error(estimate, Twist(0.0, 0.0, 0.0)) < 16.3


def test_nothing_confirms_a_single_encoder() -> None:
    """It may be stuck near its command, or the wheel is dragged although it should stand."""
    places = [(0.6, 0.0, "steered"), (-0.6, 0.4, "passive"), (-0.6, -0.4, "passive")]
    wheels = [wheel(f"w{i}", x, y, kind) for i, (x, y, kind) in enumerate(places)]
    for reading, command in ((0.35, 0.45), (-0.2, 0.0)):
        readings = JointStates(0.0, [reading / 0.2, 0.0, 0.0], [0.0] * 3, [0.0] * 3)
        estimate = estimator(wheels).estimate(readings, [command / 0.2, 0.0, 0.0])
        assert estimate.sliding == (0,)
        assert squared_error(estimate, Twist(command, 0.0, 0.0)) < 16.3
        assert estimate.twist.vx == pytest.approx(reading)


def test_skidding_wheels_of_a_side_that_disagree_are_doubted() -> None:
    """On the ground they turn equally fast.  The robot is pulled, and moves straight on."""
    speeds = [0.85 / 0.2, 1.42 / 0.2, 0.85 / 0.2, 1.42 / 0.2]
    slower = [*speeds[:3], 1.3 / 0.2]
    readings = JointStates(0.0, slower, [0.0] * 4, [0.0] * 4)
    estimate = estimator(SKID).estimate(readings, speeds)
    assert (estimate.suspects, estimate.sliding) == ((3,), (0, 1, 2))
    assert squared_error(estimate, Twist(0.85, 0.0, 0.0)) < 16.3


def test_skidding_wheels_that_a_pull_turns_unequally_are_doubted() -> None:
    """They should stand, and the robot is pulled over them."""
    speeds = [v / 0.2 for v in (-0.18, -0.34, -0.15, -0.11)]
    readings = JointStates(0.0, speeds, [0.0] * 4, [0.0] * 4)
    estimate = estimator(SKID).estimate(readings, [0.0] * 4)
    assert estimate.sliding == (0, 1, 2, 3)
    assert squared_error(estimate, Twist(-0.64, 0.1, 0.0)) < 16.3


def test_a_skidding_wheel_that_follows_its_command_slips_too() -> None:
    """The encoders of one side are reversed; the robot turns by a quarter of that of its wheels."""
    commands = [v / 0.2 for v in (1.29, 0.28, 1.29, 0.28)]
    speeds = [v if i % 2 == 0 else -v for i, v in enumerate(commands)]
    readings = JointStates(0.0, speeds, [0.0] * 4, [0.0] * 4, None, -0.45)
    estimate = estimator(SKID).estimate(readings, commands)
    assert squared_error(estimate, Twist(0.785, 0.03, -0.45)) < 16.3


def test_the_errors_of_skidding_wheels_have_a_common_part() -> None:
    """A robot on ice turns 10 % faster than its wheels, and one that is pulled drifts."""
    speeds = General(BaseGeometry.from_wheels(SKID)).command(Twist(0.0, 0.0, 0.5)).joints.speeds
    estimate = estimator(SKID).estimate(
        JointStates(0.0, speeds, [0.0] * 4, [0.0] * 4), list(speeds)
    )
    assert squared_error(estimate, Twist(0.08, 0.05, 1.1 * estimate.twist.wz)) < 16.3
    assert sigmas(estimate.covariance)[2] > 0.07 * estimate.twist.wz
    straight = JointStates(0.0, [3.0] * 4, [0.0] * 4, [0.0] * 4)
    assert sigmas(estimator(SKID).estimate(straight).covariance)[1] < 0.05


def test_wheels_that_a_push_turns_outvote_one_that_stands() -> None:
    """They contradict their commands and agree, as stuck encoders would by accident only."""
    states = joints(FOUR, Twist(0.6, 0.0, 0.0))
    estimate = estimator(FOUR).estimate(with_fault(states, 3, "0"), [0.0] * 4)
    assert estimate.dropped == (3,)
    assert estimate.twist.vx == pytest.approx(0.6, abs=0.01)


def test_correct_row_of_a_faulty_wheel_is_still_used() -> None:
    states = joints(FOUR, MOTIONS[1])
    twist_estimator = estimator(FOUR)
    slips = twist_estimator.estimate(with_fault(states, 2, "1.5")).covariance
    none = twist_estimator.estimate(with_fault(states, 2, "both")).covariance
    assert all(a < b for a, b in zip(sigmas(slips), sigmas(none), strict=True))


def test_two_faulty_wheels_are_dropped_if_the_others_suffice() -> None:
    rng = random.Random(4)
    named = total = 0
    for seed in range(60):
        i, k = rng.sample(range(6), 2)
        states = joints(SIX, MOTIONS[seed % 3], Noise(), seed)
        both = with_fault(with_fault(states, i, "1.4"), k, rng.choice(["-1", "+20 deg", "0.7"]))
        estimate = estimator(SIX).estimate(both)
        alone = estimator(SIX, faulty=1).estimate(both)
        total += 1
        named += set(estimate.dropped) == {i, k}
        # With one rejection only, no hypothesis explains it.
        assert alone.dropped == () or set(alone.dropped) <= {i, k}
        for value, true, sigma in zip(
            estimate.twist, MOTIONS[seed % 3], sigmas(estimate.covariance), strict=True
        ):
            assert abs(value - true) <= 6.0 * sigma
    assert named >= 0.95 * total


def test_two_slipping_wheels_of_four() -> None:
    """The directions of the wheels identify them."""
    rng = random.Random(5)
    named = 0
    for seed in range(40):
        i, k = rng.sample(range(4), 2)
        states = joints(FOUR, MOTIONS[seed % 3], Noise(), seed)
        estimate = estimator(FOUR).estimate(with_fault(with_fault(states, i, "1.5"), k, "0.6"))
        named += set(estimate.dropped) == {i, k}
    assert named >= 34


def test_without_a_hypothesis_all_wheels_are_kept_and_the_covariance_grows() -> None:
    states = joints(FOUR, MOTIONS[1])
    angles = [a + d for a, d in zip(states.angles, (0.5, -0.4, 0.3, -0.6), strict=True)]
    speeds = [v * f for v, f in zip(states.speeds, (0.3, 1.7, -1.0, 0.8), strict=True)]
    bad = JointStates(0.0, speeds, angles, states.angle_rates)
    estimate = estimator(FOUR).estimate(bad)
    plain = estimator(FOUR, faulty=0).estimate(bad)
    assert estimate.dropped == ()
    assert estimate.twist == plain.twist
    assert min(sigmas(estimate.covariance)) >= 5.0 * min(sigmas(plain.covariance))


def test_of_two_wheels_that_disagree_none_is_dropped() -> None:
    """Either may be faulty; the covariance covers both cases."""
    wheels = FOUR[:2]
    states = joints(wheels, Twist(0.8, 0.0, 0.0))
    estimate = estimator(wheels).estimate(with_fault(states, 0, "+20 deg"))
    assert estimate.dropped == ()
    assert estimate.covariance[2][2] > 10.0 * estimator(wheels).estimate(states).covariance[2][2]


def test_of_three_wheels_on_an_axle_none_is_dropped() -> None:
    """Each pair agrees: three equally likely hypotheses; the covariance has their differences."""
    wheels = [wheel(f"w{i}", 0.0, y, "fixed") for i, y in enumerate((0.5, 0.0, -0.5))]
    states = joints(wheels, Twist(0.5, 0.0, 0.0))
    twist_estimator = estimator(wheels)
    estimate = twist_estimator.estimate(with_fault(states, 0, "1.5"))
    assert estimate.dropped == ()
    # 0.25 m/s too much at one end: 0.5 m/s or 0.75 m/s, or a rotation in between.
    assert math.sqrt(estimate.covariance[0][0]) > 0.05
    assert math.sqrt(estimate.covariance[2][2]) > 0.1


def test_skidding_wheels_are_not_dropped() -> None:
    """In a turn of a skid-steered robot no wheel agrees with the others, and none is faulty."""
    estimate = estimator(SKID).estimate(
        JointStates(0.0, [2.0, 5.0, 2.0, 5.0], [0.0] * 4, [0.0] * 4)
    )
    assert estimate.dropped == ()
    assert estimate.chi_squares == (0.0,) * 4


def test_casters_count_in_the_indices_of_wheels() -> None:
    wheels = [wheel("c", 0.0, 0.0, "swivel"), *FOUR]
    states = joints(wheels, MOTIONS[1])
    estimate = estimator(wheels).estimate(with_fault(states, 3, "1.5"))
    assert estimate.dropped == (3,)
    assert len(estimate.chi_squares) == 5
    assert estimate.chi_squares[0] == 0.0


def test_healthy_wheels_are_rarely_dropped() -> None:
    twist_estimator = estimator(FOUR)
    noise = Noise()
    dropped = sum(
        bool(twist_estimator.estimate(joints(FOUR, MOTIONS[seed % 3], noise, seed)).dropped)
        for seed in range(1500)
    )
    assert dropped <= 0.015 * 1500


def test_slips_have_size_and_direction() -> None:
    states = joints(FOUR, Twist(0.8, 0.0, 0.0))
    twist_estimator = estimator(FOUR)
    slips = twist_estimator.slips(with_fault(states, 1, "1.5"), Twist(0.8, 0.0, 0.0))
    assert slips[0] == pytest.approx((0.0, 0.0))
    assert slips[1] == pytest.approx((-0.4, 0.0))  # the tread slides backwards over the ground
    sideways = twist_estimator.slips(states, Twist(0.8, 0.1, 0.0))
    assert sideways[3] == pytest.approx((0.0, 0.1))


def test_polish_converges_to_maximum_likelihood() -> None:
    """With direction errors of 4 deg, the first step is close, and further steps converge."""
    noise = Noise(speed_ratio=0.002, angle=math.radians(4.0))
    geometry = BaseGeometry.from_wheels(FOUR)
    steps = [
        TwistEstimator(geometry, noise, EstimatorOptions(faulty=0, polish=n)) for n in range(6)
    ]
    states = joints(FOUR, MOTIONS[1], noise, 3)
    twists = [s.estimate(states).twist for s in steps]
    moved = [max(abs(p - q) for p, q in zip(a, b, strict=True)) for a, b in pairwise(twists)]
    assert moved[0] > 1e-5
    assert moved[4] < 1e-3 * moved[0]


def test_gyro_measures_a_rotation_that_no_wheel_measures() -> None:
    wheels = [wheel("d", 0.5, 0.0, "steered"), wheel("c", -0.5, 0.3, "swivel")]
    speeds, angles = [5.0, 0.0], [0.1, 0.0]
    blind = estimator(wheels).estimate(JointStates(0.0, speeds, angles, [0.0, 0.0]))
    estimate = estimator(wheels).estimate(JointStates(0.0, speeds, angles, [0.0, 0.0], None, 0.4))
    assert (blind.rank, estimate.rank) == (2, 3)
    assert estimate.twist.wz == pytest.approx(0.4, abs=1e-6)
    assert math.sqrt(estimate.covariance[2][2]) == pytest.approx(Noise().gyro, rel=1e-3)
    # It also improves a twist of rank 3.
    states = joints(FOUR, MOTIONS[1])
    with_gyro = JointStates(0.0, states.speeds, states.angles, states.angle_rates, None, 0.4)
    alone, both = estimator(FOUR).estimate(states), estimator(FOUR).estimate(with_gyro)
    assert both.covariance[2][2] < alone.covariance[2][2]
    assert both.twist == pytest.approx(alone.twist, abs=1e-9)


def test_passive_fixed_wheel_measures_side_slip() -> None:
    wheels = [*FOUR, wheel("p", -1.5, 0.0, "passive")]
    states = joints(FOUR, Twist(0.8, 0.0, 0.0))
    more = JointStates(0.0, [*states.speeds, 0.0], [*states.angles, 0.0], [0.0] * 5)
    without, estimate = estimator(FOUR).estimate(states), estimator(wheels).estimate(more)
    assert estimate.covariance[2][2] < without.covariance[2][2]
    # When dragged sideways it disagrees, with one degree of freedom.
    askew = joints(FOUR, Twist(0.8, 0.3, 0.0))
    more = JointStates(0.0, [*askew.speeds, 0.0], [*askew.angles, 0.0], [0.0] * 5)
    assert estimator(wheels).estimate(more).dropped == (4,)


@pytest.mark.parametrize(
    "options", [{"gate": 0.0}, {"gate": 1.0}, {"faulty": 3}, {"polish": -1}, {"polish": 11}]
)
def test_options_out_of_range_are_rejected(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(options))} is"):
        EstimatorOptions(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("options", [{"faulty_wheels": 3}, {"polish": 11}])
def test_options_of_general_are_checked(options: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(options))} is"):
        GeneralOptions(**options)  # type: ignore[arg-type]
    assert General(BaseGeometry.from_wheels(FOUR), GeneralOptions(polish=2)).estimator.options == (
        EstimatorOptions(polish=2)
    )


@pytest.mark.parametrize("name", ["angle", "speed_floor", "correlation", "gyro", "radius_error"])
def test_invalid_noise_is_rejected(name: str) -> None:
    for value in (-0.1, math.nan, math.inf):
        with pytest.raises(ValueError, match=f"noise {name} is"):
            Noise(**{name: value})
