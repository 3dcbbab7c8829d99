"""Checks that a robot must pass before it is armed.

Each check is a function that returns its reasons against arming.  All reasons of all checks are
reported together, so that the operator can remove them in one go.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

from thorvaldc.model.robot import SAFETY_STOP
from thorvaldc.runtime.se2 import ZERO_TWIST

if TYPE_CHECKING:
    from thorvaldc.runtime.driven_robot import DrivenRobot

PreArmCheck = Callable[["DrivenRobot", float], Iterable[str]]
"""Function that returns the reasons against arming, from the robot and the time (s)."""
GAP_MEMORY = 2.0
"""Time (s) after a gap in time in which the robot is not armed."""


def check_base(robot: DrivenRobot, now: float) -> Iterable[str]:
    """Requires that the base is ready: nodes, drives and batteries of a robot on its buses."""
    return robot.base.arming_reasons(now)


def check_stops(robot: DrivenRobot, now: float) -> Iterator[str]:
    if robot.stop_engaged:
        yield "the safety stop is engaged"
    for name in robot.multiplexer.active_stop_locks(now):
        if not (robot.stop_engaged and name == SAFETY_STOP):
            yield f"the stop lock `{name}` is active"


def check_commands(robot: DrivenRobot, now: float) -> Iterator[str]:
    """Refuses to arm while a motion is commanded, which would start at once.

    A source counts also behind a lock and below a source of a higher priority: it would drive as
    soon as the lock is released or the other source is silent.
    """
    sources = robot.multiplexer.requests(now)
    if not sources and robot.driver.commanded_twist(now) != ZERO_TWIST:
        yield "a motion is commanded; command zero first"
    for name in sources:
        yield f"`{name}` commands a motion"


def check_time(robot: DrivenRobot, now: float) -> Iterator[str]:
    if robot.paused:
        yield "the simulation is paused"
    if robot.driver.permission.fault:
        yield robot.driver.permission.fault
    gap = robot.timing.latest_gap
    if gap is not None and now - gap[0] < GAP_MEMORY:
        yield (
            f"there was no control cycle for {gap[1] * 1000.0:.0f} ms, {now - gap[0]:.1f} s ago;"
            " is the computer too busy?"
        )


PRE_ARM_CHECKS: tuple[PreArmCheck, ...] = (check_base, check_stops, check_commands, check_time)
