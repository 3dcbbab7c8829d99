"""The driver's tick: watchdog, ramps, invalid values, odometry."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import DriverSettings
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.driver import BaseDriver, DriveMode, DriverState
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2, Twist
from thorvaldc.runtime.twist_ramp import LEAD
from thorvaldc.simulation.physics.sim_base import SimBase

ROBOT = make_robot(FOUR_STEERED)
DT = 1.0 / ROBOT.driver.rate


class Faulty(BaseHandle):
    """A base that can report a NaN and that stores its commands."""

    def __init__(self) -> None:
        self.inner = SimBase(ROBOT)
        self.bad: str | None = None
        self.written: list[JointCommands] = []

    def read(self, now: float) -> JointStates:
        states = self.inner.read(now)
        if self.bad == "short":
            return replace(states, speeds=states.speeds[:-1])
        if self.bad is not None:
            values = [*getattr(states, self.bad)]
            values[1] = math.nan
            return replace(states, **{self.bad: values})
        return states

    def write(self, commands: JointCommands, now: float) -> None:
        self.written.append(commands)
        self.inner.write(commands, now)


def run(driver: BaseDriver, twist: Twist | None, start: float, end: float) -> list[DriverState]:
    states = []
    for k in range(round(start / DT), round(end / DT)):
        if twist is not None:
            assert driver.command(twist, k * DT)
        states.append(driver.tick(k * DT))
    return states


def make_driver(**settings: Any) -> BaseDriver:
    chosen = replace(ROBOT.driver, **settings)
    return BaseDriver(ROBOT, SimBase(ROBOT), settings=chosen)


def test_follows_a_command() -> None:
    driver = make_driver()
    states = run(driver, Twist(0.5, 0.0, 0.0), 0.0, 4.0)
    last = states[-1]
    assert last.mode is DriveMode.DRIVING
    assert last.odometry.twist == pytest.approx((0.5, 0.0, 0.0), abs=1e-9)
    # Delays: one tick, half of the ramp to 0.5 m/s at 1.5 m/s^2, and half of the smoothing time,
    # in which steering reaches 4 rad/s.
    assert last.pose.x == pytest.approx(0.5 * (4.0 - 0.5 / 1.5 / 2 - 0.1), abs=0.03)
    assert last.odometry.rank == 3


@pytest.mark.parametrize(
    ("slow", "fast"),
    [
        (Twist(0.2, 0.1, 0.0), Twist(1.0, 0.5, 0.0)),
        (Twist(0.0, 0.0, 0.1), Twist(0.0, 0.0, 1.2)),
        (Twist(0.1, 0.0, 0.1), Twist(0.9, 0.0, 0.9)),
    ],
)
def test_ramp_keeps_both_accelerations_and_the_direction(slow: Twist, fast: Twist) -> None:
    driver = make_driver(max_linear_acceleration=1.0, max_angular_acceleration=0.5)
    before = run(driver, slow, 0.0, 2.0)[-1].ramped
    assert before == pytest.approx(slow)
    fastest = 0.0
    for state in run(driver, fast, 2.0, 6.0):
        now = state.ramped
        linear = math.hypot(now.vx - before.vx, now.vy - before.vy) / DT
        angular = abs(now.wz - before.wz) / DT
        assert linear <= 1.0 + 1e-9
        assert angular <= 0.5 + 1e-9
        fastest = max(fastest, linear / 1.0, angular / 0.5)
        assert now.vx * fast.wz == pytest.approx(fast.vx * now.wz, abs=1e-6)
        before = now
    assert before == pytest.approx(fast)
    assert fastest == pytest.approx(1.0, abs=1e-6)


def test_twist_limits_keep_the_centre_of_rotation() -> None:
    driver = make_driver(max_linear_velocity=0.4, max_angular_velocity=0.2)
    last = run(driver, Twist(1.0, 0.0, 1.0), 0.0, 4.0)[-1]
    assert last.ramped == pytest.approx((0.2, 0.0, 0.2))


def test_time_out_ramps_to_zero_and_holds_the_steering() -> None:
    driver = make_driver()
    driving = run(driver, Twist(0.4, 0.2, 0.3), 0.0, 3.0)[-1]
    assert driving.joints is not None
    angles = driving.joints.angles
    last_command = 3.0 - DT
    states = run(driver, None, 3.0, 5.0)
    for state in states:
        quiet = state.time - last_command
        if quiet <= 0.5 + 1e-9:
            assert state.mode is DriveMode.DRIVING
        else:
            assert state.mode is DriveMode.TIMED_OUT
        assert state.joints is not None
        assert list(state.joints.angles) == pytest.approx(list(angles), abs=1e-3)
    assert states[-1].ramped == ZERO_TWIST
    assert states[-1].joints is not None
    assert not any(states[-1].joints.speeds)
    # The stop is a ramp with the limited acceleration.
    stopping = [s for s in states if s.mode is DriveMode.TIMED_OUT and s.ramped != ZERO_TWIST]
    assert 0.15 <= len(stopping) * DT <= 0.5
    assert run(driver, Twist(0.4, 0.0, 0.0), 5.0, 6.0)[-1].mode is DriveMode.DRIVING


def test_invalid_twist_is_rejected_and_the_last_valid_one_stays() -> None:
    driver = make_driver()
    run(driver, Twist(0.5, 0.0, 0.0), 0.0, 1.0)
    for bad in (math.nan, math.inf, -math.inf):
        assert not driver.command(Twist(0.0, bad, 0.0), 1.0)
    state = driver.tick(1.0)
    assert state.commanded_twist == Twist(0.5, 0.0, 0.0)
    # A rejected command does not reset the watchdog.
    for k in range(51, 90):
        driver.command(Twist(math.nan, 0.0, 0.0), k * DT)
        state = driver.tick(k * DT)
    assert state.mode is DriveMode.TIMED_OUT


@pytest.mark.parametrize("what", ["speeds", "angles", "angle_rates", "positions", "short"])
def test_invalid_joint_states_stop_the_robot_and_keep_the_pose(what: str) -> None:
    base = Faulty()
    driver = BaseDriver(ROBOT, base)
    good = run(driver, Twist(0.5, 0.0, 0.2), 0.0, 2.0)[-1]
    base.bad = what
    bad = run(driver, Twist(0.5, 0.0, 0.2), 2.0, 3.0)
    assert all(s.mode is DriveMode.FAULT for s in bad)
    assert all(s.fault for s in bad)
    assert bad[-1].pose == good.pose
    assert bad[-1].odometry == good.odometry
    assert bad[-1].ramped == ZERO_TWIST
    for commands in base.written:
        assert all(math.isfinite(v) for v in (*commands.speeds, *commands.angles))
    base.bad = None
    held = run(driver, Twist(0.5, 0.0, 0.2), 3.0, 4.0)
    assert {s.mode for s in held} == {DriveMode.WAITING}, "a command from before is void"
    assert held[-1].hold_reason.startswith("no usable joint states (")
    assert held[-1].hold_reason.endswith("); command zero first")
    run(driver, ZERO_TWIST, 4.0, 4.1)
    after = run(driver, Twist(0.5, 0.0, 0.2), 4.1, 6.0)[-1]
    assert after.mode is DriveMode.DRIVING
    assert after.fault == ""
    assert after.odometry.twist == pytest.approx((0.5, 0.0, 0.2), abs=1e-6)


@pytest.mark.parametrize(("cycles", "goes_on"), [(2, True), (3, False)])
def test_joint_states_may_be_missing_as_long_as_a_cycle_may_be_late(
    cycles: int, goes_on: bool
) -> None:
    """One rule judges both times: 2.5 periods are no gap."""
    base, twist = Faulty(), Twist(0.5, 0.0, 0.0)
    driver = BaseDriver(ROBOT, base)
    run(driver, twist, 0.0, 2.0)
    base.bad = "speeds"
    run(driver, twist, 2.0, 2.0 + cycles * DT)
    base.bad = None
    after = run(driver, twist, 2.0 + cycles * DT, 4.0)[-1]
    assert (after.mode is DriveMode.DRIVING) is goes_on


def test_tick_at_the_same_or_an_earlier_time_does_nothing() -> None:
    driver = make_driver()
    last = run(driver, Twist(0.5, 0.0, 0.0), 0.0, 1.0)[-1]
    assert driver.tick(last.time) is last
    assert driver.tick(last.time - 5.0) is last
    assert driver.tick(math.nan) is last


def test_a_gap_keeps_the_pose_and_grows_its_covariance() -> None:
    driver = make_driver()
    last = run(driver, Twist(0.5, 0.0, 0.0), 0.0, 2.0)[-1]
    after = driver.tick(last.time + 3.0)
    assert after.pose == last.pose
    assert after.pose_covariance[0][0] >= last.pose_covariance[0][0] + 1.0
    assert after.mode is DriveMode.FAULT
    assert after.fault == "no control cycle for 3000 ms"


class Braked(Faulty):
    """A base whose wheels lose half of their speed from the time ``since`` (s) on."""

    since = math.inf

    def read(self, now: float) -> JointStates:
        states = super().read(now)
        share = 0.5 if now >= self.since else 1.0
        return replace(states, speeds=[share * speed for speed in states.speeds])


def test_after_a_gap_wheels_that_have_braked_do_not_accelerate() -> None:
    base = Braked()
    driver = BaseDriver(ROBOT, base)
    last = run(driver, Twist(0.8, 0.0, 0.0), 0.0, 2.0)[-1]
    assert last.ramped.vx == pytest.approx(0.8)
    base.since = last.time + 0.01
    driver.command(Twist(0.8, 0.0, 0.0), last.time + 0.2)
    state = driver.tick(last.time + 0.2)
    assert state.mode is DriveMode.WAITING
    assert state.ramped.vx == pytest.approx(0.4, abs=1e-6)
    assert max(base.written[-1].speeds) * ROBOT.wheels[0].radius == pytest.approx(0.4)


def test_after_a_short_gap_zero_comes_first() -> None:
    driver = make_driver()
    run(driver, Twist(0.5, 0.0, 0.0), 0.0, 1.0)
    states = run(driver, Twist(0.5, 0.0, 0.0), 1.2, 2.0)
    assert {state.mode for state in states} == {DriveMode.WAITING}
    assert states[0].hold_reason == "no control cycle for 220 ms; command zero first"
    assert states[-1].ramped == ZERO_TWIST
    run(driver, ZERO_TWIST, 2.0, 2.04)
    assert run(driver, Twist(0.5, 0.0, 0.0), 2.04, 3.0)[-1].ramped.vx == pytest.approx(0.5)


def test_a_zero_that_waited_in_a_gap_does_not_count() -> None:
    driver = make_driver()
    run(driver, Twist(0.5, 0.0, 0.0), 0.0, 1.0)
    driver.command(ZERO_TWIST, 1.2)
    driver.tick(1.2)
    driver.command(ZERO_TWIST, 1.1)  # published in the gap, and received after it
    driver.tick(1.22)
    states = run(driver, Twist(0.5, 0.0, 0.0), 1.24, 2.0)
    assert {state.mode for state in states} == {DriveMode.WAITING}


def test_after_a_long_gap_a_reset_and_zero_come_first() -> None:
    driver = make_driver()
    run(driver, Twist(0.5, 0.0, 0.0), 0.0, 1.0)
    run(driver, Twist(0.5, 0.0, 0.0), 1.4, 2.0)
    states = run(driver, ZERO_TWIST, 2.0, 2.2)
    assert {state.mode for state in states} == {DriveMode.FAULT}
    assert states[-1].fault == "no control cycle for 420 ms"
    driver.reset()
    states = run(driver, Twist(0.5, 0.0, 0.0), 2.2, 2.4)
    assert {state.mode for state in states} == {DriveMode.WAITING}
    run(driver, ZERO_TWIST, 2.4, 2.44)
    assert run(driver, Twist(0.5, 0.0, 0.0), 2.44, 3.4)[-1].ramped.vx == pytest.approx(0.5)


def test_the_pose_can_be_set() -> None:
    driver = make_driver()
    run(driver, Twist(0.5, 0.0, 0.0), 0.0, 2.0)
    driver.reset_pose(Pose2(5.0, 1.0, math.pi / 2))
    last = run(driver, Twist(0.5, 0.0, 0.0), 2.0, 4.0)[-1]
    assert last.pose == pytest.approx((5.0, 2.0, math.pi / 2), abs=0.02)
    assert last.pose_covariance[0][0] < 1e-3


def test_covariance_grows_with_the_distance() -> None:
    driver = make_driver()
    states = run(driver, Twist(0.5, 0.0, 0.1), 0.0, 6.0)
    sizes = [s.pose_covariance[0][0] + s.pose_covariance[1][1] for s in states[::50]]
    assert sizes == sorted(sizes)
    assert sizes[0] == 0.0 < sizes[-1] < 0.01


def test_without_positions_the_speeds_are_integrated() -> None:
    class SpeedsOnly(SimBase):
        def read(self, now: float) -> JointStates:
            return replace(super().read(now), positions=None)

    driver = BaseDriver(ROBOT, SpeedsOnly(ROBOT))
    last = run(driver, Twist(0.5, 0.0, 0.2), 0.0, 4.0)[-1]
    same = run(make_driver(), Twist(0.5, 0.0, 0.2), 0.0, 4.0)[-1]
    assert last.pose == pytest.approx(same.pose, abs=5e-3)


def test_after_waiting_for_the_wheels_the_robot_does_not_jump() -> None:
    """A command sideways, for a robot at rest with its wheels forward."""
    driver = make_driver(max_linear_acceleration=1.5)
    states = run(driver, Twist(0.0, 1.2, 0.0), 0.0, 4.0)
    speeds = [s.command.twist.speed for s in states if s.command is not None]
    window = 10
    gained = max(b - a for a, b in zip(speeds, speeds[window:], strict=False))
    assert gained <= 1.5 * window * DT + LEAD
    assert speeds[-1] == pytest.approx(1.2)


def test_ideal_joints_ramp_and_slew() -> None:
    base = SimBase(ROBOT)
    base.read(0.0)
    base.write(JointCommands([5.0] * 4, [1.0] * 4), 0.0)
    states = base.read(0.1)
    # 7.5 rad/s^2 and 4 rad/s.
    assert states.speeds == pytest.approx([0.75] * 4)
    assert states.angles == pytest.approx([0.4] * 4)
    assert states.angle_rates == pytest.approx([4.0] * 4)
    assert states.positions == pytest.approx([0.75 * 0.1 / 2] * 4)
    states = base.read(0.5)
    assert states.angles == pytest.approx([1.0] * 4)
    base.write(JointCommands([99.0] * 4, [9.0] * 4), 0.5)
    before = base.read(1.0)
    gap = base.read(1.6)
    assert gap.speeds == before.speeds
    assert gap.positions == before.positions
    for k in range(1, 30):
        states = base.read(1.6 + 0.1 * k)
    assert states.speeds == pytest.approx([7.48] * 4)
    assert max(states.angles) == pytest.approx(3.078027759)


def test_default_settings_are_those_of_the_robot() -> None:
    settings = DriverSettings(50.0, 0.2, 0.3, 1.0, 1.0, 1.0, 1.0, 1.0)
    driver = BaseDriver(replace(ROBOT, driver=settings), SimBase(ROBOT))
    assert run(driver, Twist(1.0, 0.0, 0.0), 0.0, 2.0)[-1].ramped.vx == pytest.approx(0.3)
    states = run(driver, None, 2.0, 2.4)
    assert states[-1].mode is DriveMode.TIMED_OUT


def test_wheels_that_turn_the_long_way_round_arrive() -> None:
    """At 135 deg, and asked for 177: past the limit, so that they turn back by nearly half a turn.

    Drawn to where the wheels happen to point, the ramp once called them back half way, for ever.
    """
    driver = BaseDriver(ROBOT, SimBase(ROBOT))
    for i, (vx, vy) in enumerate(((0.0, 0.4), (-0.3, 0.3))):
        run(driver, Twist(vx, vy, 0.0), 4.0 * i, 4.0 * i + 4.0)
    turned = run(driver, Twist(-0.4, 0.02, 0.0), 8.0, 12.0)
    angles = [s.joints.angles[0] for s in turned if s.joints is not None]
    travel = sum(abs(b - a) for a, b in pairwise(angles))
    assert travel < 4.5
    assert turned[-1].odometry.twist.vx == pytest.approx(-0.4, abs=0.01)
    assert turned[-1].odometry.twist.vy == pytest.approx(0.02, abs=0.01)
