"""The driver stops joints behind topics by its commands, whatever their joint states say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from tests.examples import example_robot
from tests.model.stops import stop_bound
from tests.ros.virtual_topics import PERIOD, VirtualTopics
from thorvaldc.model.stopping import STOP_LOCK
from thorvaldc.ros.parameters import default_silence
from thorvaldc.runtime.se2 import Twist

TOP = Twist(1.0, 0.0, 0.3)
STOPS: dict[str, Callable[[VirtualTopics], object]] = {
    "disarm": lambda rig: rig.driven.call("disarm"),
    "safety stop": lambda rig: rig.driven.call("safety_stop"),
    "stop lock": lambda rig: rig.driven.call("lock", name=rig.model.twist_locks[0].name),
    "nobody": lambda rig: None,
}


@pytest.mark.parametrize("share", [1.0, 1.5, 0.3, -1.0], ids=["same", "high", "low", "backwards"])
@pytest.mark.parametrize("how", STOPS)
def test_frozen_joint_states_sustain_no_motion(how: str, share: float) -> None:
    """The driver commanded a frozen speed for ever, and `disarm` and `safety_stop` changed nothing.

    Where nobody stops the robot, the joint states that do not change are a fault.
    """
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(TOP, 2.0)
    last = rig.engine.read(rig.now)
    frozen = replace(last, speeds=[share * speed for speed in last.speeds])
    rig.change = lambda states: replace(frozen, time=states.time)
    rig.step()
    STOPS[how](rig)
    bound = stop_bound(rig.model, STOP_LOCK)
    noticed = 0.5 + PERIOD if how == "nobody" else 0.0
    start, before, speeds = rig.now, rig.wheels(), [rig.commanded]
    while rig.now < start + noticed + bound.time:
        rig.step()
        speeds.append(rig.commanded)
    assert not rig.driven.armed
    assert not any(rig.commanded)
    assert max(speed for _, speed in rig.wheels()) == 0.0
    ways = [abs(b - a) for (a, _), (b, _) in zip(before, rig.wheels(), strict=True)]
    assert sum(ways) / len(ways) <= bound.distance + noticed * TOP.vx
    for one, next_one in pairwise(speeds):
        assert all(b <= a + 1e-9 for a, b in zip(one, next_one, strict=True))


def test_a_fault_of_the_joint_states_needs_a_reset_and_an_arming() -> None:
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(TOP, 1.0)
    rig.change = lambda states: None
    for _ in range(100):
        rig.step()
    fault = "no joint states on /engine/joint_states"
    assert rig.driven.state()["fault"] == fault
    assert rig.driven.arming_reasons(rig.driven.now)[0] == fault
    rig.change = lambda states: states
    rig.twist = Twist(0.0, 0.0, 0.0)
    for _ in range(150):
        rig.step()
    assert rig.driven.arming_reasons(rig.driven.now) == [fault]
    rig.driven.call("reset_faults")
    rig.drive(TOP, 1.0)
    assert max(rig.commanded) > 0.9


def test_a_second_of_wrong_joint_states_is_no_gap_of_the_computer() -> None:
    """After the reset, arming was refused with "is the computer too busy?" for two seconds."""
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(TOP, 1.0)
    rig.change = lambda states: replace(states, speeds=[math.nan] * len(states.speeds))
    for _ in range(50):
        rig.step()
    (reason,) = rig.driven.arming_reasons(rig.driven.now)
    assert "has the position" in reason
    assert "and the speed nan" in reason
    rig.change = lambda states: states
    rig.twist = Twist(0.0, 0.0, 0.0)
    for _ in range(75):
        rig.step()
    rig.driven.call("reset_faults")
    assert rig.driven.arming_reasons(rig.driven.now) == []


@pytest.mark.parametrize("period", [0.05, 0.1, 0.2])
def test_a_slow_engine_is_no_fault_within_the_longest_silence(period: float) -> None:
    """A Gazebo at half speed latched a fault: three gaps above 50 ms within 2 s."""
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(Twist(0.3, 0.0, 0.0), 1.0)
    for _ in range(30):
        rig.step(period)
    assert rig.driven.state()["fault"] == ""
    assert rig.driven.armed
    assert max(rig.commanded) == pytest.approx(0.3)


def test_the_longest_silence_follows_from_the_stopping_distance() -> None:
    robot = example_robot("4wd4ws_wide")
    assert default_silence(robot) == 0.25
    quick = replace(robot, driver=replace(robot.driver, command_timeout=0.16))
    assert default_silence(quick) == 0.08
    rig = VirtualTopics(quick)
    rig.drive(TOP, 1.0)
    rig.change = lambda states: None
    for _ in range(3):
        rig.step()
    assert rig.driven.armed
    for _ in range(4):
        rig.step()
    assert not rig.driven.armed


def test_joints_may_change_their_order() -> None:
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(TOP, 3.0)
    for rig.backwards in (True, False, True):
        rig.step()
        read, true = rig.driven.driver.state.joints, rig.engine.read(rig.now)
        assert read is not None
        assert len(set(read.angles)) > 1
        assert read.angles == pytest.approx(true.angles)
        assert read.speeds == pytest.approx(true.speeds)


def test_a_guard_that_has_ended_is_named() -> None:
    rig = VirtualTopics(example_robot("4wd4ws_wide"))
    rig.drive(TOP, 0.2)
    assert rig.driven.base.warnings(rig.now) == []
    rig.guarded = False
    (warning,) = rig.driven.base.warnings(rig.now)
    assert warning.startswith("no joint_guard hears /engine/heartbeat")
