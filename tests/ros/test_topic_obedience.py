"""An engine that does not do what it is commanded to is a fault that names the joint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from tests.examples import example_robot
from tests.model.stops import stop_bound
from tests.ros.virtual_topics import PERIOD, VirtualTopics
from thorvaldc.model.stopping import STOP_LOCK
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.se2 import Twist

FORWARD = Twist(0.6, 0.0, 0.0)
NOTICED = 1.2
"""s; a wheel speed may match no recent target for 1 s."""


class IgnoredCommands:
    """The joints keep the speeds that they have at first; their positions are a little noisy."""

    def __init__(self, rig: VirtualTopics) -> None:
        self._first: JointStates | None = None
        self._sign = 1e-9

    def __call__(self, states: JointStates) -> JointStates:
        first = self._first = self._first or states
        self._sign = -self._sign
        elapsed = states.time - first.time
        places = zip(first.positions or (), first.speeds, strict=True)
        positions = [p + v * elapsed + self._sign for p, v in places]
        return replace(first, time=states.time, positions=positions)


class WrongSigns:
    """The drives turn backwards."""

    def __init__(self, rig: VirtualTopics) -> None:
        pass

    def __call__(self, states: JointStates) -> JointStates:
        positions = [-p for p in states.positions or ()]
        return replace(states, speeds=[-v for v in states.speeds], positions=positions)


class Jumps:
    """The positions jump by 1 rad in each message, and the speeds say nothing of it."""

    def __init__(self, rig: VirtualTopics) -> None:
        self._jump = 0.0

    def __call__(self, states: JointStates) -> JointStates:
        self._jump += 1.0
        return replace(states, positions=[p + self._jump for p in states.positions or ()])


class TwoEngines:
    """A second engine sends every second message, and its robot stands."""

    def __init__(self, rig: VirtualTopics) -> None:
        self._other = False
        self._still = [0.0] * len(rig.model.wheels)

    def __call__(self, states: JointStates) -> JointStates:
        self._other = not self._other
        if not self._other:
            return states
        return replace(states, speeds=self._still, positions=self._still)


class OwnMotion:
    """The first wheel turns by itself."""

    def __init__(self, rig: VirtualTopics) -> None:
        self._start = rig.now

    def __call__(self, states: JointStates) -> JointStates:
        positions = list(states.positions or ())
        speeds = list(states.speeds)
        positions[0] += 0.5 * (states.time - self._start)
        speeds[0] += 0.5
        return replace(states, speeds=speeds, positions=positions)


Engine = Callable[[VirtualTopics], Callable[[JointStates], JointStates]]
ROBOTS = ("4wd4ws_wide", "2wd0ws_greenhouse")


def begin(robot: str, twist: Twist = FORWARD) -> VirtualTopics:
    rig = VirtualTopics(example_robot(robot))
    rig.drive(twist, 3.0)
    assert rig.driven.state()["fault"] == ""
    return rig


def fault_of(rig: VirtualTopics, seconds: float) -> str:
    """Runs until the robot reports a fault, for at most ``seconds``; returns the fault."""
    for _ in range(round(seconds / PERIOD)):
        rig.step()
        if fault := str(rig.driven.state()["fault"]):
            rig.step()  # which disarms
            return fault
    return ""


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("engine", [IgnoredCommands, WrongSigns, Jumps, TwoEngines])
def test_an_engine_that_does_not_obey_is_named_while_the_robot_drives(
    engine: Engine, robot: str
) -> None:
    rig = begin(robot)
    rig.change = engine(rig)
    rig.twist = Twist(-0.6, 0.0, 0.0)  # the ramp through zero takes two seconds
    fault = fault_of(rig, 3.0 + NOTICED)
    assert fault.startswith("by the joint states on /engine/joint_states, the joint "), fault
    assert "does not follow its target" in fault
    assert not rig.driven.armed
    bound = stop_bound(rig.model, STOP_LOCK)
    for _ in range(round(bound.time / PERIOD) + 1):
        rig.step()
    assert not any(rig.commanded)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("how", ["zero", "disarm", "safety_stop"])
def test_an_engine_that_ignores_a_stop_is_named(how: str, robot: str) -> None:
    rig = begin(robot)
    rig.change = IgnoredCommands(rig)
    if how == "zero":
        rig.twist = Twist(0.0, 0.0, 0.0)
    else:
        rig.driven.call(how)
    bound = stop_bound(rig.model, STOP_LOCK)
    fault = fault_of(rig, bound.time + NOTICED)
    assert "the joint " in fault
    assert "does not follow its target" in fault


@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize("engine", [Jumps, OwnMotion])
def test_a_joint_that_moves_by_itself_is_named_at_rest(engine: Engine, armed: bool) -> None:
    rig = begin("4wd4ws_wide", Twist(0.0, 0.0, 0.0))
    if not armed:
        rig.driven.call("disarm")
    rig.change = engine(rig)
    fault = fault_of(rig, 2.0)
    assert "turns, although it is commanded to stand" in fault or "does not follow" in fault, fault
    assert not rig.driven.armed
    assert not any(rig.commanded)


def test_an_engine_that_ignores_the_stop_of_another_fault_is_named_too() -> None:
    rig = begin("4wd4ws_wide")
    ignored = IgnoredCommands(rig)
    ignored(rig.engine.read(rig.now))
    rig.change = lambda states: None
    assert fault_of(rig, 1.0) == "no joint states on /engine/joint_states"
    rig.change = ignored
    for _ in range(150):
        rig.step()
    fault = str(rig.driven.state()["fault"])
    first, second = fault.split("; ")
    assert first == "no joint states on /engine/joint_states"
    assert second.startswith("by the joint states on /engine/joint_states, the joint ")


def test_an_obedient_engine_is_not_blamed() -> None:
    """Turns, reversals and stops within the limits of the robot."""
    rig = begin("4wd4ws_wide")
    for twist in (Twist(1.0, 0.0, 0.5), Twist(-1.0, 0.0, 0.0), Twist(0.0, 0.5, 0.0)):
        for each in (twist, Twist(0.0, 0.0, 0.0), Twist(0.0, 0.0, 1.0)):
            rig.drive(each, 3.0)
            assert rig.driven.state()["fault"] == ""
            assert rig.driven.armed
