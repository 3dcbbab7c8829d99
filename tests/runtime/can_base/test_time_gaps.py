"""The process of the base driver is stopped while the robot drives, with both kinds of drives."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.robots import FOUR_STEERED, make_robot
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import ROBOTS
from tests.slow import mostly_exhaustive
from thorvaldc.can.frame import CanFrame
from thorvaldc.model.stopping import shortest_watchdog
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.pace import Gap, TimeGapRule
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface

SPEED = 0.8
FAST = Twist(SPEED, 0.0, 0.0)
NOISE = 0.01
"""Largest rise (m/s) of a wheel speed that is no acceleration: whole revolutions per minute."""

both = pytest.mark.parametrize("kind", mostly_exhaustive(reversed(ROBOTS)))


def driving(kind: str) -> Rig:
    rig = Rig(ROBOTS[kind]())
    rig.drive(FAST, 2.0)
    return rig


def sampled(rig: Rig, seconds: float) -> list[float]:
    """Runs the driver and returns the true speed after each cycle."""
    speeds = []
    for _ in range(round(seconds / rig.base.period)):
        rig.run(rig.base.period)
        speeds.append(rig.speed())
    return speeds


def largest_rise(speeds: list[float]) -> float:
    lowest, rise = speeds[0], 0.0
    for speed in speeds:
        lowest = min(lowest, speed)
        rise = max(rise, speed - lowest)
    return rise


@both
@pytest.mark.parametrize(
    "stall", mostly_exhaustive([0.1, 0.25, 1.0, 0.05, 0.2, 0.3, 0.55, 0.7, 5.0], 3)
)
def test_the_robot_comes_to_rest_and_stays(kind: str, stall: float) -> None:
    """The command is repeated all the time, as by a joystick that is held."""
    rig = driving(kind)
    speeds = rig.stall(stall)
    speeds += sampled(rig, 2.0)
    assert largest_rise(speeds) < NOISE
    assert speeds[-1] == 0.0
    is_long = stall + rig.base.period >= 0.25
    assert rig.state is (BaseState.FAULT if is_long else BaseState.READY)
    assert rig.reason.startswith("no control cycle for") is is_long


@both
def test_a_missing_cycle_is_no_gap(kind: str) -> None:
    rig = driving(kind)
    rig.stall(0.03)  # 0.05 s from cycle to cycle
    speeds = sampled(rig, 1.0)
    assert rig.state is BaseState.ACTIVE
    assert min(speeds) > SPEED - 0.05


@both
def test_after_a_short_gap_a_zero_twist_releases_the_robot(kind: str) -> None:
    rig = driving(kind)
    rig.stall(0.15)
    sampled(rig, 1.5)
    state = rig.driven.driver.state
    assert state.hold_reason == "no control cycle for 170 ms; command zero first"
    rig.twist = ZERO_TWIST
    rig.run(0.1)
    rig.twist = FAST
    assert sampled(rig, 2.0)[-1] == pytest.approx(SPEED, abs=0.02)


@both
def test_after_a_long_gap_a_reset_and_arming_release_the_robot(kind: str) -> None:
    rig = driving(kind)
    rig.stall(0.7)
    sampled(rig, 1.0)
    with pytest.raises(RequestRefused, match="a motion is commanded"):
        rig.driven.reset()
    rig.twist = ZERO_TWIST
    rig.run(0.1)
    rig.driven.reset()
    rig.until(lambda: rig.state is BaseState.READY)
    rig.twist = FAST
    assert max(sampled(rig, 1.0)) == 0.0
    rig.run(2.0)
    rig.drive(FAST, 2.0)
    assert rig.speed() == pytest.approx(SPEED, abs=0.02)


def test_limits_come_from_the_shortest_watchdog() -> None:
    robot = ROBOTS["CiA 402"]()
    assert shortest_watchdog(robot) == 0.5
    assert shortest_watchdog(ROBOTS["Thorvald script"]()) == 0.5
    bus = robot.buses[0]
    first, *others = bus.nodes
    quick = replace(first, heartbeat_consumer_time=0.2)
    changed = replace(robot, buses=(replace(bus, nodes=(quick, *others)),))
    rule = TimeGapRule.of(changed, changed.driver)
    assert [rule.judge(t) for t in (0.05, 0.06, 0.1)] == [Gap.NONE, Gap.SHORT, Gap.LONG]


def test_without_drives_on_a_bus_the_command_timeout_decides() -> None:
    robot = make_robot(FOUR_STEERED)
    settings = replace(robot.driver, command_timeout=1.0)
    rule = TimeGapRule.of(robot, settings)
    assert [rule.judge(t) for t in (0.05, 0.06, 0.49, 0.5)] == [
        Gap.NONE,
        Gap.SHORT,
        Gap.SHORT,
        Gap.LONG,
    ]


def test_a_slow_control_cycle_has_no_short_gap() -> None:
    """2.5 periods are longer than half the watchdog: each gap is long."""
    robot = make_robot(FOUR_STEERED)
    rule = TimeGapRule.of(robot, replace(robot.driver, rate=5.0))
    assert [rule.judge(t) for t in (0.5, 0.51)] == [Gap.NONE, Gap.LONG]


class StoppedWhileSending(VirtualTimeInterface):
    """Its process is stopped for ``seconds`` before the frame number ``at`` of a cycle is sent."""

    at = 0
    seconds = 0.0

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        if self.at > 0:
            self.at -= 1
            if self.at == 0:
                self.sleep(self.seconds)
        return super().send(frame, timeout)


@both
@pytest.mark.parametrize("seconds", mostly_exhaustive([0.2, 0.7, 0.03], 2))
@pytest.mark.parametrize("frame", mostly_exhaustive([1, 4, 2, 5], 2))
def test_at_most_one_old_frame_is_sent(kind: str, seconds: float, frame: int) -> None:
    """The process is stopped while it sends the frames of a cycle, and goes on."""
    rig = driving(kind)
    interface = rig.interface
    assert isinstance(interface, VirtualTimeInterface)
    interface.__class__ = StoppedWhileSending
    assert isinstance(interface, StoppedWhileSending)
    interface.at, interface.seconds = frame, seconds
    robot = rig.robot
    commands = {f.cob_id for b in robot.buses for f in b.frames if f.producer == "master"}
    rig.frames.clear()
    start = rig.now
    sent_by = rig.base.cycles
    rig.driven.run(start + rig.base.period)
    resumed = start + seconds
    old = [f for t, f in rig.frames if f.id in commands and t / 1e9 > resumed]
    assert len(old) <= 1, old
    assert rig.base.cycles == sent_by, "the cycle is incomplete: no heartbeat of the master"
    speeds = [rig.speed(), *sampled(rig, 2.0)]
    if seconds < 0.05:  # no gap: one cycle is missing
        assert rig.state is BaseState.ACTIVE
    else:
        assert largest_rise(speeds) < NOISE
        assert rig.speed() == 0.0
        assert rig.state is (BaseState.FAULT if seconds > 0.25 else BaseState.READY)
