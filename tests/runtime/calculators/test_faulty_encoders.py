"""Any number of faulty encoders: the estimate is never wrong and sure, and says what it doubts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bench.faulty_encoders import FAULTS, SPINNING, robots, study
from tests.conformance.wheels import wheel
from tests.runtime.calculators.test_wheel_causes import FOUR, MOTIONS, joints
from tests.runtime.can_base.simulated_rig import FORWARD
from tests.runtime.test_driven_robot import ROBOT, Operators
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.runtime.calculators.differential import Differential
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimator
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.physics.sim_base import SimBase

ROBOTS = robots()
THREE = list(ROBOTS["3 steered"].wheels)
SKID_STEERED = [(0.5, 0.4), (0.5, -0.4), (-0.5, 0.4), (-0.5, -0.4)]


def with_speeds(states: JointStates, speeds: dict[int, float]) -> JointStates:
    measured = [speeds.get(i, v) for i, v in enumerate(states.speeds)]
    return JointStates(states.time, measured, states.angles, states.angle_rates)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_estimates_are_not_overconfident(robot: str, fault: str) -> None:
    """At most 1 % of the motions are outside of the 99.9 % ellipsoid, for any number of faults."""
    geometry = ROBOTS[robot]
    samples = 40
    most = len(geometry.wheels) - (fault in SPINNING)
    shares = [study(geometry, fault, k, samples) for k in range(1, most + 1)]
    assert sum(s.outside for s in shares) <= len(shares) + 100.0 / samples
    assert max(s.nees for s in shares) <= 2.5
    # A covariance that is always large would be easy, but useless.
    if fault == "dead" and robot in ("3 steered", "4 steered", "6 steered"):
        for k in range(1, len(geometry.wheels)):
            share = study(geometry, fault, k, samples, gyro=True)
            assert share.named >= 50.0
            assert share.wrong <= 200.0 / samples
            assert share.nees <= 1.6


@pytest.mark.parametrize("motion", MOTIONS[:3], ids=str)
def test_a_gyro_names_two_of_three_dead_encoders_in_a_turn(motion: Twist) -> None:
    states = joints(THREE, motion)
    estimator = TwistEstimator(BaseGeometry.from_wheels(THREE))
    dead = replace(with_speeds(states, {0: 0.0, 2: 0.0}), yaw_rate=motion.wz)
    estimate = estimator.estimate(dead, states.speeds)
    if motion.wz:
        assert estimate.dropped == (0, 2)
        assert estimate.suspects == estimate.sliding == ()
        assert estimate.twist == pytest.approx(motion, abs=0.01)
    else:
        assert estimate.sliding == (1,)
        assert {0, 2} <= set(estimate.suspects)


def test_without_commands_a_minority_that_moves_is_not_left_out() -> None:
    states = joints(THREE, Twist(0.8, 0.0, 0.0))
    estimator = TwistEstimator(BaseGeometry.from_wheels(THREE))
    estimate = estimator.estimate(with_speeds(states, {0: 0.0, 2: 0.0}))
    assert estimate.dropped == ()
    assert estimate.suspects == (0, 1, 2)
    assert 0.4 <= math.sqrt(estimate.covariance[0][0]) <= 0.6


@pytest.mark.parametrize("share", [0.0, -1.0])
def test_the_covariance_contains_the_command_if_all_wheels_contradict_theirs(share: float) -> None:
    """All encoders are dead or reversed, or the robot stands or rolls back: nothing decides."""
    states = joints(FOUR, Twist(0.8, 0.0, 0.0))
    wrong = with_speeds(states, {i: share * v for i, v in enumerate(states.speeds)})
    estimator = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    estimate = estimator.estimate(wrong, states.speeds)
    assert estimate.twist.vx == pytest.approx(0.8 * share, abs=0.03)
    assert 0.4 <= math.sqrt(estimate.covariance[0][0]) / (1.0 - share) <= 0.8
    assert (estimate.dropped, estimate.suspects) == ((), (0, 1, 2, 3))


@pytest.mark.parametrize("motion", MOTIONS, ids=str)
def test_wheels_that_agree_and_turn_as_commanded_change_nothing(motion: Twist) -> None:
    """Also while a delay or a load lets them all deviate from their commands."""
    states = joints(FOUR, motion)
    estimator = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    for share in (1.0, 0.9, 1.5):
        commanded = [share * v for v in states.speeds]
        assert estimator.estimate(states, commanded) == estimator.estimate(states)


def test_a_robot_that_is_pushed_is_not_suspect() -> None:
    states = joints(FOUR, Twist(0.8, 0.0, 0.0))
    estimator = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    assert estimator.estimate(states, [0.0] * 4) == estimator.estimate(states)


@pytest.mark.parametrize("places", [[(0.0, 0.4), (0.0, -0.4)], SKID_STEERED], ids=["two", "skid"])
def test_a_wheel_that_stands_while_the_robot_is_pushed_is_doubted(
    places: list[tuple[float, float]],
) -> None:
    """Its encoder is dead.  No other wheel confirms it, or wheels that skid are not tested."""
    wheels = [wheel(f"w{i}", x, y, "fixed") for i, (x, y) in enumerate(places)]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    zeros = [0.0] * len(wheels)
    pushed = JointStates(0.0, [2.0] * len(wheels), zeros, zeros)
    assert estimator.estimate(pushed, zeros) == estimator.estimate(pushed)
    for dead in range(1, len(wheels)):
        estimate = estimator.estimate(with_speeds(pushed, dict.fromkeys(range(dead), 0.0)), zeros)
        error = np.array(estimate.twist) - (0.4, 0.0, 0.0)
        assert error @ np.linalg.solve(np.array(estimate.covariance), error) <= 16.27
        assert estimate.suspects


def test_two_encoders_that_are_stuck_at_different_speeds_are_no_push() -> None:
    wheels = [wheel(f"w{i}", 0.0, y, "fixed") for i, y in enumerate((0.4, -0.4))]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    stuck = JointStates(0.0, [1.2, -1.8], [0.0] * 2, [0.0] * 2)
    estimate = estimator.estimate(stuck, [0.0] * 2)
    assert estimate.suspects == (0, 1)
    error = np.array(estimate.twist)
    assert error @ np.linalg.solve(np.array(estimate.covariance), error) <= 16.27


def test_closed_form_of_two_wheels_compares_them_with_their_commands() -> None:
    wheels = [wheel("left", 0.0, 0.4, "fixed"), wheel("right", 0.0, -0.4, "fixed")]
    calculator = Differential(BaseGeometry.from_wheels(wheels))
    joint_commands = calculator.command(Twist(0.8, 0.0, 0.0)).joints
    states = JointStates(0.0, joint_commands.speeds, joint_commands.angles, [0.0, 0.0])
    assert calculator.odometry(states).suspects == ()
    estimate = calculator.odometry(with_speeds(states, {0: 0.0}))
    assert (estimate.suspects, estimate.sliding) == ((0,), (1,))
    assert 0.4 <= math.sqrt(estimate.covariance[2][2]) <= 1.5


def test_wheels_that_skid_may_disagree_by_any_amount() -> None:
    """They are not tested, so that their fit may be much less likely than the other causes."""
    wheels = [wheel(f"w{i}", x, y, "fixed") for i, (x, y) in enumerate(SKID_STEERED)]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    zeros = [0.0] * 4
    estimate = estimator.estimate(JointStates(0.0, [0.0, -2.0, 0.0, 4.0], zeros, zeros), [-4.0] * 4)
    assert estimate.suspects
    assert estimate.twist.vx - 2.5 * math.sqrt(estimate.covariance[0][0]) <= -0.8


@pytest.mark.parametrize("angle", [0.0, 2.57])
def test_a_wheel_that_the_others_need_is_not_left_out(angle: float) -> None:
    """Without the steered wheel, two fixed wheels of different axles determine no twist."""
    wheels = [wheel("a", 0.0, -0.37, "steered"), wheel("b", 0.0, 0.92, "passive")]
    wheels.append(wheel("c", 0.5, -0.33, "fixed"))
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))
    states = JointStates(0.0, [0.0, 0.0, 1.1], [angle, 0.0, 0.0], [0.0] * 3)
    estimate = estimator.estimate(states, [1.1, 0.0, 1.1])
    assert min(np.linalg.eigvalsh(estimate.covariance)) > 0.0


@pytest.mark.parametrize("others", [0.0, 3.0])
def test_a_reading_that_no_wheel_can_reach_is_left_out(others: float) -> None:
    """Such as the jump of a counter: the robot is not doubted to move with 600 m/s."""
    estimator = TwistEstimator(BaseGeometry.from_wheels(FOUR))
    states = JointStates(0.0, [3000.0, others, others, others], [0.0] * 4, [0.0] * 4)
    estimate = estimator.estimate(states, [others] * 4)
    assert estimate.dropped == (0,)
    assert estimate.twist == pytest.approx((0.2 * others, 0.0, 0.0), abs=1e-3)
    assert math.sqrt(estimate.covariance[0][0]) <= 0.01


@pytest.mark.parametrize("gyro", [None, 0.0])
def test_warnings_do_not_say_that_a_wheel_turns_and_does_not(gyro: float | None) -> None:
    wheels = [wheel("left", 0.0, 0.4, "fixed"), wheel("right", 0.0, -0.4, "fixed")]
    wheels.append(wheel("caster", 0.6, 0.0, "swivel", trail=0.1))
    calculator = Differential(BaseGeometry.from_wheels(wheels))
    speeds = calculator.command(Twist(0.6, 0.0, 0.5 if gyro == 0.0 else 0.0)).joints.speeds
    odometry = Odometry(calculator, (1.5, 1.0))
    for tick in range(150):
        measured = [0.0] * 3 if gyro is None else [*speeds]
        states = JointStates(0.02 * tick, measured, [0.0] * 3, [0.0] * 3, yaw_rate=gyro)
        odometry.update(states, states.time)
    (warning,) = odometry.warnings
    assert "left, right may be wrong, or the robot does not move as commanded" in warning


def three_driving_wheels() -> tuple[Odometry, JointStates]:
    """Returns the odometry of a robot that is commanded to drive, and its joint states then."""
    calculator = General(BaseGeometry.from_wheels(THREE))
    calculator.command(Twist(0.8, 0.0, 0.0))
    return Odometry(calculator, (1.5, 1.0)), joints(THREE, Twist(0.8, 0.0, 0.0))


def test_odometry_warns_of_lasting_faults_only() -> None:
    odometry, states = three_driving_wheels()

    def warnings_after(ticks: int, speeds: dict[int, float]) -> list[str]:
        for _ in range(ticks):
            time = odometry.joints.time + 0.02 if odometry.joints else 0.0
            measured = with_speeds(states, speeds)
            odometry.update(replace(measured, time=time), time)
        return odometry.warnings

    assert warnings_after(20, {}) == []
    assert warnings_after(25, {0: 0.0, 2: 0.0}) == []
    (undecided,) = warnings_after(60, {0: 0.0, 2: 0.0})
    assert "w1 turns as commanded" in undecided
    assert "w0, w2" in undecided
    assert warnings_after(120, {}) == []
    (doubted,) = warnings_after(90, dict.fromkeys(range(3), 0.0))
    assert "w0, w1, w2" in doubted
    assert warnings_after(120, {}) == []
    (dropped,) = warnings_after(90, {0: 12.0})
    assert "left out w0" in dropped


def test_a_doubt_after_a_pause_does_not_count_for_the_pause() -> None:
    odometry, states = three_driving_wheels()
    odometry.update(states, 0.0)
    odometry.update(replace(with_speeds(states, {0: 0.0, 2: 0.0}), time=10.0), 10.0)
    assert odometry.estimate.suspects
    assert odometry.warnings == []


class DyingEncoders(SimBase):
    """Ideal joints, of which three encoders of four die."""

    are_dead = False

    def read(self, now: float) -> JointStates:
        states = super().read(now)
        if not self.are_dead:
            return states
        return replace(states, speeds=[*states.speeds[:1], 0.0, 0.0, 0.0], positions=None)


def test_the_state_of_a_robot_shows_the_warnings() -> None:
    base = DyingEncoders(ROBOT)
    operators = Operators(ROBOT, base)
    operators.drive()
    robot = operators.robot
    assert robot.state()["warnings"] == []
    base.are_dead = True
    operators.run(3.0)
    (warning,) = robot.state()["warnings"]
    assert warning.startswith("odometry: stuck, or encoders dead?")
    odometry = robot.driver.state.odometry
    sigma = math.sqrt(odometry.covariance[0][0])
    for true in (0.0, FORWARD.vx):
        assert abs(odometry.twist.vx - true) <= 2.5 * sigma
