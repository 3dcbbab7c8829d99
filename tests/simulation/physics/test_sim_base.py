"""Joints of the simulated base without physics: ramps, limits and positions."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.simulation.physics.sim_base import SimBase

ROBOT = make_robot(FOUR_STEERED)
WHEELS = BaseGeometry.from_robot(ROBOT).wheels


def command(base: SimBase, speed: float, angle: float) -> None:
    base.write(JointCommands([speed] * 4, [angle] * 4), 0.0)


def test_speeds_ramp_and_positions_are_their_integral() -> None:
    limit, rate = WHEELS[0].max_speed, WHEELS[0].max_acceleration
    base = SimBase(ROBOT)
    base.read(0.0)
    command(base, -99.0, 0.0)
    states = base.read(0.125)
    assert states.time == 0.125
    assert states.speeds == pytest.approx([-0.125 * rate] * 4)
    assert states.positions == pytest.approx([-0.5 * rate * 0.125**2] * 4)
    command(base, 0.0, 0.0)
    states = base.read(0.375)  # at rest after 0.125 s
    assert states.speeds == (0.0,) * 4
    assert states.positions == pytest.approx([-rate * 0.125**2] * 4)
    command(base, 99.0, 0.0)
    for tick in range(100):
        states = base.read(0.375 + 0.125 * tick)
    assert states.speeds == (limit,) * 4


def test_angles_turn_at_their_rate_up_to_their_limits() -> None:
    wheel = WHEELS[0]
    assert wheel.lower is not None
    assert wheel.upper is not None
    for angle, bound in ((99.0, wheel.upper), (-99.0, wheel.lower)):
        base = SimBase(ROBOT, 10.0)
        base.read(10.0)
        command(base, 0.0, angle)
        states = base.read(10.125)
        step = 0.125 * wheel.max_rate * (1.0 if angle > 0.0 else -1.0)
        assert states.angles == pytest.approx([step] * 4)
        assert states.angle_rates == pytest.approx([step / 0.125] * 4)
        for tick in range(2, 100):
            states = base.read(10.0 + 0.125 * tick)
        assert states.angles == (bound,) * 4
        assert states.angle_rates == (0.0,) * 4


def test_time_does_not_go_back() -> None:
    base = SimBase(ROBOT)
    base.read(1.0)
    command(base, 1.0, 0.0)
    assert base.read(0.5).time == 1.0
    assert base.read(1.0).speeds == (0.0,) * 4


def test_a_wheel_without_a_motor_does_not_turn() -> None:
    names = {ROBOT.wheels[0].spin_joint}
    actuators = tuple(a for a in ROBOT.actuators if a.joint not in names)
    base = SimBase(replace(ROBOT, actuators=actuators))
    base.read(0.0)
    command(base, 1.0, 0.0)
    assert [bool(v) for v in base.read(0.125).speeds] == [False, True, True, True]
