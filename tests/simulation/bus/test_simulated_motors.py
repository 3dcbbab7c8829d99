"""Motors without load, and encoders, at times that the tests choose."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.simulation.bus.robots import cia402_robot
from thorvaldc.simulation.bus.simulated_motors import (
    DrivenWheels,
    Encoder,
    IdealMotor,
    MotorState,
    ideal_motor,
)
from thorvaldc.simulation.physics.sim_base import Coasting


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


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motor_without_power_rolls_out(sign: float) -> None:
    """Free for 0.5 s at 0.4 rad/s^2, then with a closed brake at 1 rad/s^2."""
    ideal = IdealMotor(4.0, 20.0, 10.0, coasting=Coasting(0.4, 1.0, 0.5))
    ideal.turn(1.0 * sign, 0.0)
    start = ideal.read(1.0).position
    ideal.release(1.0)
    assert ideal.read(1.25).velocity == pytest.approx(0.9 * sign)
    ideal.release(1.3)  # a device repeats it in every cycle
    assert ideal.read(1.5) == (pytest.approx(start + 0.45 * sign), pytest.approx(0.8 * sign), 0.0)
    assert ideal.read(2.0).velocity == pytest.approx(0.3 * sign)
    assert ideal.read(9.0) == (pytest.approx(start + (0.45 + 0.32) * sign), 0.0, 0.0)
    ideal.turn(1.0 * sign, 9.0)
    assert ideal.read(10.0).velocity == 1.0 * sign


def test_a_motor_that_has_no_friction_rolls_on() -> None:
    ideal = IdealMotor(4.0, 20.0, 10.0, coasting=Coasting(0.0, 0.0))
    ideal.turn(1.0, 0.0)
    ideal.read(1.0)
    ideal.release(1.0)
    assert ideal.read(60.0).velocity == 1.0


def test_the_ground_couples_a_wheel_without_power_to_the_others() -> None:
    wheels = DrivenWheels()
    fast, slow = (
        IdealMotor(4.0, 2.0, 10.0, coasting=Coasting(0.1, 0.1), wheels=wheels) for _ in range(2)
    )
    wheels.add(fast, 0.2)
    wheels.add(slow, 0.4)
    fast.turn(4.0, 0.0)
    slow.turn(2.0, 0.0)
    assert [m.read(4.0).velocity for m in (fast, slow)] == [4.0, 2.0]
    fast.release(4.0)
    slow.turn(0.0, 4.0)
    assert fast.read(4.5).velocity <= 2.0  # 1 rad/s of the larger wheel
    assert slow.read(5.0).velocity == 0.0
    assert fast.read(5.0).velocity == 0.0
    slow.turn(2.0, 5.0)
    assert fast.read(7.0).velocity == 0.0
    slow.release(7.0)
    assert slow.read(8.0).velocity == pytest.approx(1.9)  # no wheel has power


def test_stops_of_the_motor_of_a_joint() -> None:
    robot = cia402_robot()
    actuator = robot.actuators[0]
    joint = next(j for j in robot.joints if j.name == actuator.joint)

    def motor_with(lower: float | None, upper: float | None) -> IdealMotor:
        changed = replace(joint, lower=lower, upper=upper)
        joints = tuple(changed if j is joint else j for j in robot.joints)
        return ideal_motor(replace(robot, joints=joints), actuator)

    wide = motor_with(-4.0, 5.0)
    assert (wide.lower, wide.upper) == (-4.0, 5.0)
    narrow = motor_with(-1.0, 2.0)
    assert (narrow.lower, narrow.upper) == (-math.pi, math.pi)
    free = motor_with(None, None)
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
