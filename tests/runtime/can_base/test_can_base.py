"""The base on its simulated buses: start, drive, stop, shutdown."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402_robot, drives, uneven_robot
from tests.slow import mostly_exhaustive
from thorvaldc.can.canopen import DriveState, NmtState
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.cia402_device import Cia402Drive
from thorvaldc.simulation.bus.roboteq_device import RoboteqController

EXAMPLES = Path(__file__).parents[3] / "examples"


@functools.cache
def example(name: str) -> Robot:
    done = compile_file(EXAMPLES / name / "robot.yaml")
    assert isinstance(done.model, Robot)
    return done.model


def four_wheels() -> Robot:
    return example("4wd4ws_wide")


ROBOTS = {
    "two propulsions": lambda: example("2wd0ws_greenhouse"),
    "roboteq": four_wheels,
    "cia402": cia402_robot,
    "nine wheels": lambda: example("9wd9ws"),
    "uneven": uneven_robot,
}


@pytest.mark.parametrize("make", mostly_exhaustive(ROBOTS.values(), 2), ids=list(ROBOTS))
def test_a_robot_starts_drives_stops_and_shuts_down(make: functools.partial[Robot]) -> None:
    rig = Rig(make())
    rig.ready()
    names = [change.state for change in rig.base.changes]
    assert names == [
        BaseState.INIT,
        BaseState.PREOP,
        BaseState.CONFIG,
        *([BaseState.STANDBY] if any(w.steering_joint for w in rig.robot.wheels) else []),
        BaseState.HOMING,
        BaseState.READY,
    ]
    assert rig.speed() == 0.0
    start = rig.now
    rig.drive(Twist(0.4, 0.0, 0.0), 4.0)
    joints = rig.driven.driver.state.joints
    assert joints is not None
    pose = rig.driven.driver.state.pose
    assert rig.speed() == pytest.approx(0.4, rel=0.02)
    assert 1.2 < pose.x < 1.7
    assert abs(pose.y) < 0.01
    rig.twist = ZERO_TWIST
    assert rig.until(lambda: rig.state is BaseState.READY) < 2.0
    assert rig.base.incomplete == 0
    assert rig.driven.timing.overruns == 0
    rig.driven.shutdown()
    assert rig.speed() == 0.0
    for device in rig.simulated.devices.values():
        if isinstance(device, RoboteqController | Cia402Drive):
            assert device.state is NmtState.PRE_OPERATIONAL
    assert rig.now > start


def test_an_axis_without_limits_follows_a_direction_that_rotates() -> None:
    rig = Rig(uneven_robot())
    rig.drive(Twist(0.4, 0.0, 0.0), 1.0)
    for k in range(1, 33):
        direction = 0.2 * k  # more than a turn
        rig.twist = Twist(0.4 * math.cos(direction), 0.4 * math.sin(direction), 0.0)
        rig.run(0.5)
        assert rig.state is BaseState.ACTIVE, rig.reason
    rig.run(3.0)
    joints = rig.driven.driver.state.joints
    assert joints is not None
    for angle, speed, wheel in zip(joints.angles, joints.speeds, rig.robot.wheels, strict=True):
        assert math.cos(angle - direction) * speed * wheel.radius == pytest.approx(0.4, rel=0.03)


def test_the_drives_are_off_after_the_shutdown() -> None:
    rig = Rig(drives())
    rig.drive()
    rig.driven.shutdown()
    for device in rig.simulated.devices.values():
        if isinstance(device, Cia402Drive):
            assert all(a.states.state is DriveState.SWITCH_ON_DISABLED for a in device.axes)


def test_equal_runs_give_equal_frames() -> None:
    runs = []
    for _ in range(2):
        rig = Rig(four_wheels(), seed=7)
        rig.drive(Twist(0.3, 0.2, 0.1), 1.0)
        runs.append((rig.frames, rig.driven.driver.state.pose))
    assert runs[0] == runs[1]
