"""Motors without load, and encoders, at times that the tests choose."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.simulation.bus.robots import cia402_robot
from thorvaldc.simulation.bus.simulated_motors import Encoder, IdealMotor, MotorState, ideal_motor


def motor(**stops: float) -> IdealMotor:
    return IdealMotor(4.0, 2.0, 10.0, **stops)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_commanded_speed_is_reached_on_a_ramp(sign: float) -> None:
    ideal = motor()
    ideal.turn(3.0 * sign, 0.0)
    assert ideal.read(0.5) == (0.25 * sign, sign, 10.0 * sign)
    assert ideal.read(2.0) == (2.25 * sign + 1.5 * sign, 3.0 * sign, pytest.approx(20 / 3 * sign))
    assert ideal.read(3.0) == (6.75 * sign, 3.0 * sign, 0.0)
    assert ideal.read(3.0) == ideal.read(2.0), "time does not go back"
    ideal.turn(-99.0 * sign, 3.0)
    position, velocity, torque = ideal.read(6.5)
    assert (velocity, torque) == (-4.0 * sign, -10.0 * sign)
    assert position == pytest.approx((6.75 - 0.5 * 3.5) * sign)
    ideal.release(6.5)
    assert ideal.read(8.5).velocity == 0.0
    assert ideal.read(9.0).torque == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_commanded_position_is_reached_with_the_top_speed(sign: float) -> None:
    ideal = motor()
    ideal.hold(3.0 * sign, 0.0)
    assert ideal.read(0.5) == (2.0 * sign, 4.0 * sign, 0.0)
    assert ideal.read(1.0) == (3.0 * sign, 2.0 * sign, 0.0)
    assert ideal.read(1.5) == (3.0 * sign, 0.0, 0.0)
    ideal.turn(1.0, 1.5)
    assert ideal.read(2.5).velocity == 1.0


def test_mechanical_stops() -> None:
    ideal = motor(lower=-1.0, upper=2.0)
    ideal.turn(4.0, 0.0)
    assert ideal.read(2.0) == (2.0, 0.0, 10.0)
    ideal.turn(-4.0, 2.0)
    assert ideal.read(6.0) == (-1.0, 0.0, -10.0)
    ideal.hold(0.5, 6.0)
    assert ideal.read(8.0).position == 0.5


def test_a_blocked_motor_pushes() -> None:
    ideal = motor()
    ideal.hold(1.0, 0.0)
    ideal.read(1.0)
    assert ideal.read(2.0) == (1.0, 0.0, 0.0)
    ideal.blocked = True
    ideal.turn(-2.0, 2.0)
    assert ideal.read(3.0) == (1.0, 0.0, -10.0)
    ideal.hold(1.0, 3.0)
    assert ideal.read(4.0) == (1.0, 0.0, 0.0)


def test_stops_of_the_motor_of_a_joint() -> None:
    robot = cia402_robot()
    actuator = robot.actuators[0]
    joint = next(j for j in robot.joints if j.name == actuator.joint)
    wide = ideal_motor(actuator, replace(joint, lower=-4.0, upper=5.0))
    assert (wide.lower, wide.upper) == (-4.0, 5.0)
    narrow = ideal_motor(actuator, replace(joint, lower=-1.0, upper=2.0))
    assert (narrow.lower, narrow.upper) == (-math.pi, math.pi)
    free = ideal_motor(actuator, replace(joint, lower=None, upper=None))
    assert (free.lower, free.upper) == (-math.inf, math.inf)
    assert free.max_velocity == actuator.max_velocity
    assert free.max_acceleration == actuator.max_acceleration
    assert free.max_torque == actuator.max_torque


def test_encoder() -> None:
    encoder = Encoder(42.0, 1024)
    assert encoder.counts_per_radian == pytest.approx(42 * 4096 / math.tau)
    assert encoder.measure(MotorState(1.0, 2.0, 3.0)) == (1.0, 2.0)
    encoder.set_zero(MotorState(0.75, 0.0, 0.0))
    assert encoder.measure(MotorState(1.0, 2.0, 3.0)) == (0.25, 2.0)
    assert encoder.joint_position(0.25) == 1.0
    encoder.jump(0.5)
    assert encoder.measure(MotorState(1.0, 2.0, 3.0)) == (0.75, 2.0)
    encoder.frozen = True
    assert encoder.measure(MotorState(9.0, 2.0, 3.0)) == (0.75, 0.0)
    encoder.frozen = False
    encoder.set_zero(MotorState(1.0, 0.0, 0.0), 42 * 4096 / math.tau)
    assert encoder.measure(MotorState(3.0, 0.0, 0.0))[0] == pytest.approx(3.0)
