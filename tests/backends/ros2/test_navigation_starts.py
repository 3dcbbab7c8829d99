"""The generated Nav2 moves the robot: which of its motions begin, and which wait for a new one.

The velocity smoother is replaced by its rule: each step changes the twist by at most the generated
acceleration, it begins with the first step, and it is silent after its ramp to zero.
"""

from __future__ import annotations

import dataclasses

import pytest

from tests.backends.ros2.packages import parameters
from tests.examples import example_robot
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.sim_base import SimBase

ROBOT = example_robot("4wd4ws_wide")
SMOOTHER = parameters(ROBOT)["/velocity_smoother"]
SPEED = 0.6


class Navigation:
    """An armed robot that follows the generated Nav2; ``goal``: twist of its controller."""

    def __init__(self) -> None:
        self.robot = DrivenRobot(ROBOT, SimBase(ROBOT), factor=0.0)
        self.goal: Twist | None = None
        self.joystick: Twist | None = None
        self.sent: list[float] = []
        self._smoothed = self._due = 0.0
        self.run(1.0)
        self.robot.arm()

    def run(self, seconds: float) -> float:
        """Returns the highest speed (m/s) of the robot."""
        robot, fastest = self.robot, 0.0
        for _ in range(round(seconds / robot.period)):
            if robot.now >= self._due - 1e-9:
                self._due = robot.now + 1.0 / SMOOTHER["smoothing_frequency"]
                self._smooth()
            if self.joystick is not None:
                robot.multiplexer.publish("teleop_joy", self.joystick, robot.input_time, "joy")
            robot.step()
            fastest = max(fastest, robot.driver.state.odometry.twist.vx)
        return fastest

    def _smooth(self) -> None:
        target = 0.0 if self.goal is None else self.goal.vx
        if self.goal is None and self._smoothed == 0.0:
            return
        step = SMOOTHER["max_accel"][0] / SMOOTHER["smoothing_frequency"]
        self._smoothed += min(max(target - self._smoothed, -step), step)
        self.sent.append(self._smoothed)
        twist = Twist(self._smoothed, 0.0, 0.0)
        self.robot.multiplexer.publish("auto_nav", twist, self.robot.input_time, "nav2")

    def drive(self) -> None:
        self.goal = Twist(SPEED, 0.0, 0.0)
        assert self.run(2.0) == pytest.approx(SPEED)

    def end_goal(self, silence: float = 2.0) -> None:
        """The controller ends; the smoother ramps to zero."""
        self.goal = None
        self.run(silence)

    def stands_until_a_new_goal(self) -> None:
        """The stream goes on and does not move the robot; a new one does, with or without a
        silence before it."""
        assert self.run(3.0) == 0.0
        assert self.robot.driver.state.hold_reason.endswith("command zero first")
        self.end_goal()
        self.drive()


def test_the_first_goal_and_the_next_ones() -> None:
    navigation = Navigation()
    navigation.drive()
    assert 0.0 < navigation.sent[0] < 0.1  # it begins with a motion, and not with zero
    for silence in (0.0, 0.3, 0.6, 5.0):
        navigation.end_goal(silence + 2.0)
        navigation.drive()


@pytest.mark.parametrize("timeout", [0.5, 0.2, 2.0])
def test_the_stamps_of_the_smoother_never_become_too_old(timeout: float) -> None:
    """It repeats the last stamp until its time-out and one message longer, and then stamps anew;
    what is older than the command time-out is refused, and silence needs a zero."""
    driver = dataclasses.replace(ROBOT.driver, command_timeout=timeout)
    robot = dataclasses.replace(ROBOT, driver=driver)
    longest = parameters(robot)["/velocity_smoother"]["velocity_timeout"]
    period = 1.0 / SMOOTHER["smoothing_frequency"]
    assert 0.0 < longest <= timeout - 2.0 * period + 1e-9


def test_the_collision_monitor_is_not_silent_while_nav2_commands() -> None:
    """Its progress checker gives a goal up after 10 s, and then its recoveries follow."""
    assert parameters(ROBOT)["/collision_monitor"]["stop_pub_timeout"] >= 600.0


@pytest.mark.parametrize("begins", ["before", "during"])
def test_a_stream_behind_a_lock_does_not_move_the_robot_when_it_is_released(begins: str) -> None:
    """Neither one that never stopped, nor one that began during the pause."""
    navigation = Navigation()
    if begins == "before":
        navigation.drive()
    navigation.robot.lock("auto_nav_pause")
    navigation.goal = Twist(SPEED, 0.0, 0.0)
    navigation.run(2.0)
    assert navigation.run(5.0) == 0.0
    navigation.robot.lock("auto_nav_pause", False)
    navigation.stands_until_a_new_goal()


def test_a_goal_after_a_pause_moves_the_robot() -> None:
    navigation = Navigation()
    navigation.drive()
    navigation.robot.lock("auto_nav_pause")
    navigation.end_goal()
    navigation.robot.lock("auto_nav_pause", False)
    navigation.drive()


def test_a_stream_below_the_joystick_does_not_move_the_robot_when_the_joystick_is_silent() -> None:
    navigation = Navigation()
    navigation.drive()
    navigation.joystick = ZERO_TWIST
    navigation.run(3.0)
    navigation.joystick = None
    navigation.run(ROBOT.driver.command_timeout)
    navigation.stands_until_a_new_goal()


def test_a_stream_that_was_interrupted_does_not_go_on() -> None:
    """The network was down; the smoother has gone on meanwhile."""
    navigation = Navigation()
    navigation.drive()
    navigation._due = navigation.robot.now + 2.0
    navigation.run(1.9)
    assert navigation.run(0.1) == 0.0
    navigation.stands_until_a_new_goal()


def test_a_disarmed_robot_is_armed_when_the_navigation_is_silent() -> None:
    navigation = Navigation()
    navigation.drive()
    navigation.robot.disarm()
    assert navigation.run(3.0) > 0.0
    assert navigation.robot.arming_reasons(navigation.robot.now) == ["`auto_nav` commands a motion"]
    navigation.end_goal()
    navigation.robot.arm()
    navigation.drive()
