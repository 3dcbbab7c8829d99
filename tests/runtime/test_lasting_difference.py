"""A robot that does not follow its commanded twist says so, whatever the cause."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.following import case
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCommand
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.driver import BaseDriver, DriverState
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.sim_base import SimBase

ROBOT = make_robot(FOUR_STEERED)
DT = 1.0 / ROBOT.driver.rate


class HalfAsFast(General):
    """A calculator with a mistake: the robot drives half of the commanded twist."""

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        return super().command(twist.scaled(0.5), states, dt)


class NeverSideways(General):
    """A calculator that forbids a motion which the wheels allow."""

    def feasible(self, twist: Twist) -> Twist:
        return super().feasible(twist._replace(vy=0.0))


class HeldSteering(SimBase):
    """A base whose steering joints stand still, as with a blown fuse."""

    def write(self, commands: JointCommands, now: float) -> None:
        super().write(replace(commands, angles=[0.0] * len(commands.angles)), now)


def reports(driver: BaseDriver, twists: list[Twist], start: float = 0.0) -> list[DriverState]:
    states = []
    for k, twist in enumerate(twists):
        now = start + k * DT
        driver.command(twist, now)
        states.append(driver.tick(now))
    return states


def seconds(time: float) -> int:
    return round(time / DT)


def wrong_driver() -> BaseDriver:
    return BaseDriver(ROBOT, SimBase(ROBOT), HalfAsFast(BaseGeometry.from_robot(ROBOT)))


def test_a_difference_without_a_known_cause_is_reported_after_the_time_of_any_ramp() -> None:
    states = reports(wrong_driver(), [Twist(0.6, 0.0, 0.0)] * seconds(15.0))
    first = next(state for state in states if state.not_followed)
    assert 4.0 < first.time < 12.0
    assert first.not_followed.startswith(f"for {first.time:.0f} s, the robot drives (0.")
    assert first.not_followed.endswith("instead of (0.6 m/s, 0 m/s, 0 rad/s): cause unknown")
    assert all(state.not_followed for state in states if state.time > first.time)
    assert states[-1].infeasible == ZERO_TWIST


def test_a_new_command_and_a_stop_start_the_time_again_but_a_trembling_command_does_not() -> None:
    trembling = [Twist(0.6 + 0.02 * (-1) ** k, 0.0, 0.0) for k in range(seconds(12.0))]
    driver = wrong_driver()
    assert reports(driver, trembling)[-1].not_followed
    after = reports(driver, [Twist(0.0, 0.6, 0.0)] * 5, 12.0)
    assert not any(state.not_followed for state in after)
    assert not reports(driver, [ZERO_TWIST] * seconds(12.0), 12.2)[-1].not_followed


def test_a_calculator_that_forbids_a_motion_is_named() -> None:
    calculator = NeverSideways(BaseGeometry.from_robot(ROBOT))
    driver = BaseDriver(ROBOT, SimBase(ROBOT), calculator)
    text = reports(driver, [Twist(0.5, 0.4, 0.0)] * seconds(12.0))[-1].not_followed
    assert text.endswith("its base calculator does not allow it")


def test_held_steering_joints_are_named() -> None:
    driver = BaseDriver(ROBOT, HeldSteering(ROBOT))
    text = reports(driver, [Twist(0.0, 0.5, 0.0)] * seconds(15.0))[-1].not_followed
    assert text.endswith("did not reach the commanded steering angle")
    assert all(wheel.name in text for wheel in ROBOT.wheels)


def test_a_speed_limit_and_a_motor_at_its_speed_limit_are_named() -> None:
    top = ROBOT.driver.max_linear_velocity
    driver = BaseDriver(ROBOT, SimBase(ROBOT))
    text = reports(driver, [Twist(3.0 * top, 0.0, 0.0)] * seconds(20.0))[-1].not_followed
    assert f"limited by max_linear_velocity {top:.4g} m/s" in text

    driver = BaseDriver(ROBOT, SimBase(ROBOT))
    turn = Twist(0.95 * top, 0.0, 0.95 * ROBOT.driver.max_angular_velocity)
    text = reports(driver, [turn] * seconds(20.0))[-1].not_followed
    assert text.endswith("is at its speed limit")


@pytest.fixture(scope="module")
def car() -> Robot:
    """A car whose fixed axle is not under ``base_link``."""
    return case("car, +-35 deg", 500)[0]


def test_wheels_that_cannot_steer_to_the_command_are_named(car: Robot) -> None:
    driver = BaseDriver(car, SimBase(car))
    text = reports(driver, [Twist(0.5, 0.0, 0.8)] * seconds(12.0))[-1].not_followed
    assert text.endswith("w0, w1 cannot steer to it")
    driver = BaseDriver(car, SimBase(car))
    text = reports(driver, [Twist(0.0, 0.5, 0.0)] * seconds(12.0))[-1].not_followed
    assert text.endswith("its fixed wheels do not allow it")


def test_the_swing_of_a_fixed_axle_is_no_difference(car: Robot) -> None:
    """In a turn, ``base_link`` before the axle also moves sideways: the user made no mistake."""
    states = reports(BaseDriver(car, SimBase(car)), [Twist(0.5, 0.0, 0.1)] * seconds(12.0))
    assert states[-1].infeasible.vy < -0.05
    assert not any(state.not_followed for state in states)


def test_ordinary_changes_are_never_reported() -> None:
    """Reversals, sideways motions and turns on the spot, one after the other."""
    driver = BaseDriver(ROBOT, SimBase(ROBOT))
    twists = [Twist(1.0, 0.0, 0.3), Twist(-1.0, 0.0, 0.3), Twist(0.0, 0.8, 0.0)]
    twists += [Twist(0.0, 0.0, 0.8), Twist(0.3, -0.3, -0.5), ZERO_TWIST]
    sequence = [twist for twist in twists for _ in range(seconds(7.0))]
    assert not any(state.not_followed for state in reports(driver, sequence))
