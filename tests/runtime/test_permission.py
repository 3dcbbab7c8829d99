"""The permission to move at the seams of a running robot: who starts it, who stops it.

Every state of the permission is explored in ``test_exploration.py``.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.chaos.chaos_robots import differential_cia402
from tests.robots import FOUR_STEERED, make_robot
from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.runtime.test_driven_robot import Operators, with_driver
from thorvaldc.model import TwistInput
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.runtime.service_table import ServiceError

ROBOT = make_robot(FOUR_STEERED)
AUTOMATIC = with_driver(ROBOT, arming="automatic")


# -- a refused service changes nothing ------------------------------------------------------------


def test_a_refused_arm_does_not_switch_automatic_arming_on_again() -> None:
    operators = Operators(AUTOMATIC)
    operators.drive()
    robot = operators.robot
    robot.call("disarm", "connection 1")
    robot.call("lock", "connection 1", name="safety_stop")
    operators.run(2.0)
    before = robot.driver.permission.value
    with pytest.raises(ServiceError, match="the stop lock `safety_stop` is active"):
        robot.call("arm", "connection 2")
    assert robot.driver.permission.value == before
    robot.call("lock", "connection 1", name="safety_stop", locked=False)
    operators.held["auto_nav"] = ZERO_TWIST
    operators.run(1.0)
    operators.held["auto_nav"] = FORWARD
    assert operators.run(3.0) == 0.0


def test_a_release_that_is_refused_changes_nothing() -> None:
    robot = Operators().robot
    robot.call("lock", "connection 1", name="auto_nav_pause")
    before = robot.driver.permission.value
    with pytest.raises(ServiceError, match="was set by connection 1"):
        robot.call("lock", "connection 2", name="auto_nav_pause", locked=False)
    assert robot.driver.permission.value == before


# -- a source that was ineffective commands zero --------------------------------------------------


GATE = TwistInput("gate", "gate/lock", 50, 0.5)


@pytest.mark.parametrize("first_command", ["zero", "any"])
@pytest.mark.parametrize("cause", ["a lock", "a silent lock", "a higher source", "disarmed"])
def test_a_source_that_was_ineffective_commands_zero_unless_it_resumes(
    cause: str, first_command: str
) -> None:
    sources = tuple(replace(s, first_command=first_command) for s in ROBOT.twist_sources)
    locks = (*ROBOT.twist_locks, GATE) if cause == "a silent lock" else ROBOT.twist_locks
    operators = Operators(replace(ROBOT, twist_sources=sources, twist_locks=locks))
    robot = operators.robot
    gate_open = True

    def keep_gate(deadline: float) -> None:
        if cause == "a silent lock" and gate_open:
            robot.lock("gate", False)

    robot.before_cycle = keep_gate
    operators.drive()
    if cause == "a lock":
        robot.lock("auto_nav_pause")
    elif cause == "a silent lock":
        gate_open = False
    elif cause == "a higher source":
        operators.held["teleop_joy"] = ZERO_TWIST
    else:
        robot.disarm()
    operators.run(2.0)
    assert operators.run(0.5) == 0.0
    gate_open = True
    robot.lock("auto_nav_pause", False)
    operators.held["teleop_joy"] = None
    if cause == "disarmed":
        with pytest.raises(RequestRefused, match="`auto_nav` commands a motion"):
            robot.arm()
    resumes = first_command == "any" and cause != "disarmed"
    assert (operators.run(3.0) > 0.4) is resumes
    if not resumes and cause != "disarmed":
        assert robot.driver.state.hold_reason.endswith("command zero first")
        operators.held["auto_nav"] = ZERO_TWIST
        operators.run(0.1)
        operators.held["auto_nav"] = FORWARD
        assert operators.run(1.0) > 0.4


# -- whoever holds a stop is named ----------------------------------------------------------------


@pytest.mark.parametrize("first", ["service", "lock"])
def test_two_reasons_to_be_stopped_are_released_in_either_order(first: str) -> None:
    rig = Rig(differential_cia402())
    rig.driven.feed = None
    rig.ready()
    robot = rig.driven
    releases = {
        "service": lambda: robot.call("release_safety_stop", "connection 1"),
        "lock": lambda: robot.call("lock", "connection 2", name="safety_stop", locked=False),
    }
    holders = {"service": "connection 1", "lock": "connection 2"}
    robot.call("safety_stop", "connection 1")
    robot.call("lock", "connection 2", name="safety_stop")
    rig.run(0.5)
    assert sorted(robot.state()["stopped_by"]) == ["connection 1", "connection 2"]
    releases.pop(first)()
    rig.run(0.1)
    (second,) = releases
    state = robot.state()
    assert (state["locks"], state["stopped_by"]) == (["safety_stop"], [holders[second]])
    with pytest.raises(ServiceError, match=r"the (safety stop|stop lock `safety_stop`) is"):
        robot.call("arm")
    releases[second]()
    rig.run(0.1)
    assert (robot.state()["locks"], robot.state()["stopped_by"]) == ([], [])
    robot.call("reset_faults")
    rig.ready()
    robot.call("arm")
    assert robot.armed


# -- homing ---------------------------------------------------------------------------------------


def test_a_robot_without_steering_has_nothing_to_home() -> None:
    """The service refuses, and an armed robot stays as it is."""
    rig = Rig(differential_cia402())
    rig.ready()
    rig.arm()
    before = rig.driven.driver.permission.value
    with pytest.raises(ServiceError, match="the robot has no steering joints to home"):
        rig.driven.call("home_steering")
    rig.run(0.1)
    assert rig.driven.driver.permission.value == before
    with pytest.raises(ServiceError, match="this base has no joints to home"):
        Operators().robot.call("home_steering")
