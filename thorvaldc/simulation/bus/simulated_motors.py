"""Models of motors and encoders for simulated motor controllers."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import NamedTuple

from thorvaldc.model import Actuator, Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.simulation.physics.sim_base import Coasting, SimulatedJoints, coasting_of

POSITION_GAIN = 10.0
"""Speed of a joint divided by the distance from the commanded position (1/s)."""

LEAD = 0.2
"""Largest distance (rad) between a moving commanded position and a joint that lags behind."""
STOP = math.pi
"""Angle (rad) of the mechanical stops of a joint with smaller limits."""


class MotorState(NamedTuple):
    """The position, speed and torque of a motor, measured at the joint.

    * ``position``: joint position (rad), not wrapped.
    * ``velocity``: joint velocity (rad/s).
    * ``torque``: joint torque (N m).
    """

    position: float
    velocity: float
    torque: float


class MotorModel(abc.ABC):
    """A motor with a gear that drives a joint.

    Positions are in rad, speeds in rad/s and torques in N m, all at the joint behind the gear.
    Times are in s and never decrease.  A motor command applies until the next motor command.  If
    ``blocked`` is true, the joint of the motor cannot move.

    - ``direction``: -1 if positions and speeds count against the joint, as seen by a motor
      controller.
    - ``push``: speed (rad/s) that something else adds to the joint, such as a slope.
    - ``runaway``: speed (rad/s) with which the motor turns whatever is commanded, or ``None``.
    """

    blocked = False
    direction = 1
    push = 0.0
    runaway: float | None = None

    def disturb(self, now: float, *, push: float = 0.0, runaway: float | None = None) -> None:
        """Sets ``push`` and ``runaway`` from the time ``now`` (s) on."""
        self.read(now)
        self.push, self.runaway = push, runaway

    @abc.abstractmethod
    def read(self, now: float) -> MotorState:
        """Returns the state of the joint at the time ``now`` (s)."""

    @abc.abstractmethod
    def turn(self, velocity: float, now: float) -> None:
        """Commands a velocity (rad/s), which the motor reaches as fast as possible."""

    @abc.abstractmethod
    def hold(self, position: float, now: float) -> None:
        """Commands a position (rad), which the motor reaches as fast as possible and holds."""

    @abc.abstractmethod
    def release(self, now: float) -> None:
        """Switches the power stage off, so that the motor applies no torque."""


class IdealMotor(MotorModel):
    """A model of a motor without load.

    The motor accelerates to a commanded velocity with ``max_acceleration`` (rad/s^2).  The motor
    moves to a commanded position with ``max_velocity`` (rad/s).  ``lower`` and ``upper`` are the
    positions (rad) of the mechanical stops.

    A motor without power rolls out as ``coasting`` states, by default with ``max_acceleration``.
    ``wheels`` are the driven wheels of the robot, if the motor turns one of them.
    """

    def __init__(
        self,
        max_velocity: float,
        max_acceleration: float,
        max_torque: float = 0.0,
        lower: float = -math.inf,
        upper: float = math.inf,
        position: float = 0.0,
        coasting: Coasting | None = None,
        wheels: DrivenWheels | None = None,
    ) -> None:
        self.max_velocity = max_velocity
        self.max_acceleration = max_acceleration
        self.max_torque = max_torque
        self.lower = lower
        self.upper = upper
        self._position = position
        self._velocity = 0.0
        self._torque = 0.0
        self._time = 0.0
        self._speed: float | None = 0.0
        self._goal: float | None = None
        self._coasting = coasting or Coasting(max_acceleration, max_acceleration)
        self._wheels = wheels
        self._off_since: float | None = None

    @property
    def has_power(self) -> bool:
        return self._off_since is None

    def read(self, now: float) -> MotorState:
        self._advance(now)
        return MotorState(self._position, self._velocity, self._torque)

    def turn(self, velocity: float, now: float) -> None:
        self._advance(now)
        self._speed, self._goal, self._off_since = velocity, None, None

    def hold(self, position: float, now: float) -> None:
        self._advance(now)
        self._speed, self._goal, self._off_since = None, position, None

    def release(self, now: float) -> None:
        self._advance(now)
        if self._off_since is None:
            self._speed, self._goal, self._off_since = 0.0, None, now

    def _advance(self, now: float) -> None:
        dt = now - self._time
        if dt <= 0.0:
            return
        self._time = now
        if self.runaway is not None or self.push:
            self._advance_disturbed(dt)
            return
        if self._speed == 0.0 and self._velocity == 0.0:  # at rest, as most motors mostly are
            self._torque = 0.0
            return
        start, speed = self._position, self._velocity
        if self._off_since is not None:
            if self._wheels is not None:
                limit = self._wheels.fastest_with_power(now) / self._wheels.radius(self)
                speed = min(max(speed, -limit), limit)
            off_for = now - dt - self._off_since
            self._velocity, angle = self._coasting.roll(speed, off_for, dt)
            end, self._torque = start + angle, 0.0
        elif self._goal is not None:
            reach = self.max_velocity * dt
            change = min(max(self._goal - start, -reach), reach)
            end, self._velocity = start + change, change / dt
            self._torque = 0.0
        else:
            limit = self.max_velocity
            commanded = min(max(self._speed or 0.0, -limit), limit)
            step = self.max_acceleration * dt
            self._velocity = min(max(commanded, speed - step), speed + step)
            # The joint position changes with the mean speed during the speed ramp, and with the
            # final speed during the rest of the time step dt.
            ramp = min(abs(self._velocity - speed) / self.max_acceleration, dt)
            end = start + (speed + self._velocity) / 2.0 * ramp + self._velocity * (dt - ramp)
            share = (self._velocity - speed) / step
            self._torque = share * self.max_torque
        position = min(max(end, self.lower), self.upper)
        if self.blocked or position != end:
            push = end - start if self.has_power else 0.0
            self._torque = math.copysign(self.max_torque, push) if push else 0.0
            self._velocity = 0.0
            position = start if self.blocked else position
        self._position = position

    def _advance_disturbed(self, dt: float) -> None:
        """Moves a joint that does not only move as commanded."""
        if self.runaway is not None:
            velocity = self.runaway
        else:
            commanded = 0.0 if self._speed is None else self._speed
            velocity = min(max(commanded, -self.max_velocity), self.max_velocity) + self.push
        step = self.max_acceleration * dt
        change = min(max(velocity - self._velocity, -step), step)
        self._velocity += change
        self._position += self._velocity * dt
        self._goal = None if self._goal is None else self._goal + self._velocity * dt


class DrivenWheels:
    """The ideal motors that turn the wheels of one robot.

    The ground couples the wheels of a robot: a wheel without power rolls no faster than the fastest
    wheel with power.  The wheel does not hold the robot back, and the robot does not drag it.
    """

    def __init__(self) -> None:
        self._radii: dict[IdealMotor, float] = {}

    def add(self, motor: IdealMotor, radius: float) -> None:
        """Adds the motor of a wheel with the radius ``radius`` (m)."""
        self._radii[motor] = radius

    def radius(self, motor: IdealMotor) -> float:
        """Returns the radius (m) of the wheel of a motor."""
        return self._radii[motor]

    def fastest_with_power(self, now: float) -> float:
        """Returns the speed (m/s) of the fastest wheel with power, infinite without one."""
        return max(
            (
                abs(motor.read(now).velocity) * radius
                for motor, radius in self._radii.items()
                if motor.has_power
            ),
            default=math.inf,
        )


class BaseMotors:
    """The motors of a simulated base.

    Each actuator has a motor model.  All motor models use the same base.  The simulation of the
    base advances when the base is read.
    """

    def __init__(self, robot: Robot, base: SimulatedJoints) -> None:
        self.base = base
        base.expect_single_commands()
        n = len(robot.wheels)
        self._commands = JointCommands([0.0] * n, [0.0] * n)
        self._states: JointStates | None = None
        self._read_at = -1.0
        self._joints: dict[str, tuple[int, bool]] = {}
        """(wheel index, true for a steering joint) by joint name."""
        for i, wheel in enumerate(robot.wheels):
            self._joints[wheel.spin_joint] = (i, False)
            if wheel.steering_joint is not None:
                self._joints[wheel.steering_joint] = (i, True)

    def motor(self, actuator: Actuator) -> MotorModel | None:
        """Returns the motor model of an actuator, or ``None`` if the actuator moves no wheel."""
        joint = self._joints.get(actuator.joint)
        return None if joint is None else _BaseMotor(self, *joint)

    def states(self, now: float) -> JointStates:
        if self._states is None or now > self._read_at:
            self._states, self._read_at = self.base.read(now), now
        return self._states

    def write(self, wheel: int, steering: bool, value: float, now: float) -> None:
        commands = self._commands
        speeds, angles = list(commands.speeds), list(commands.angles)
        (angles if steering else speeds)[wheel] = value
        self._commands = JointCommands(speeds, angles)
        self.states(now)
        self.base.write(self._commands, now)

    def switch(self, wheel: int, steering: bool, on: bool, now: float) -> None:
        self.states(now)
        self.base.switch_motor(wheel, steering, on, now)


class _BaseMotor(MotorModel):
    """The motor of one joint of a simulated base.

    A steering joint is commanded by angle, and a spin joint is commanded by speed.  The base cannot
    block a joint, so that the motor of a blocked joint keeps its power and holds the joint.
    """

    def __init__(self, motors: BaseMotors, wheel: int, steering: bool) -> None:
        self._motors = motors
        self._wheel = wheel
        self._steering = steering
        self._commanded: float | None = None
        self._turning: tuple[float, float] | None = None
        self._has_power = True

    def read(self, now: float) -> MotorState:
        states, i = self._motors.states(now), self._wheel
        if self._steering:
            if self._turning is not None:
                self._advance_steering(now)
            return MotorState(states.angles[i], states.angle_rates[i], 0.0)
        position = states.positions[i] if states.positions is not None else 0.0
        return MotorState(position, states.speeds[i], 0.0)

    def turn(self, velocity: float, now: float) -> None:
        self._switch(True, now)
        if not self._steering:
            self._write(velocity, now)
            return
        # The base controls a steering joint by position.  The commanded position of a steering
        # joint therefore moves with the commanded speed.
        if self._turning is None:
            self._commanded = self.read(now).position
        else:
            self._advance_steering(now)
        self._turning = (velocity, now)

    def hold(self, position: float, now: float) -> None:
        self._turning = None
        self._switch(True, now)
        if self._steering:
            self._write(position, now)
        else:
            self._write(POSITION_GAIN * (position - self.read(now).position), now)

    def release(self, now: float) -> None:
        here = self.read(now).position
        self._turning = None
        self._write(here if self._steering else 0.0, now)
        self._switch(self.blocked, now)

    def _switch(self, on: bool, now: float) -> None:
        if on is not self._has_power:
            self._has_power = on
            self._motors.switch(self._wheel, self._steering, on, now)

    def _advance_steering(self, now: float) -> None:
        if self._turning is not None and self._commanded is not None:
            velocity, since = self._turning
            self._turning = (velocity, now)
            here = self._motors.states(now).angles[self._wheel]
            position = self._commanded + velocity * (now - since)
            self._write(min(max(position, here - LEAD), here + LEAD), now)

    def _write(self, value: float, now: float) -> None:
        if self.blocked:  # the closest that a base offers: a command to stay
            value = self._motors.states(now).angles[self._wheel] if self._steering else 0.0
        elif not self._steering:
            value = value + self.push if self.runaway is None else self.runaway
        if value != self._commanded:
            self._commanded = value
            self._motors.write(self._wheel, self._steering, value, now)


class Encoder:
    """An incremental encoder on the motor shaft with four counts per pulse.

    The encoder count is 0 at power-on.  If ``frozen`` is true, the encoder repeats the last count.
    ``noise``: returns a wrong speed (rad/s), or ``None`` where the measured speed is right.
    """

    def __init__(self, gear_ratio: float, pulses: int) -> None:
        self.gear_ratio = gear_ratio
        self.pulses = pulses
        self.frozen = False
        self.noise: Callable[[], float | None] | None = None
        self._zero = 0.0
        self._last = (0.0, 0.0)

    @property
    def counts_per_radian(self) -> float:
        """Number of encoder counts per rad of the joint."""
        return 4.0 * self.pulses * self.gear_ratio / math.tau

    def set_zero(self, state: MotorState, counts: float = 0.0) -> None:
        """Sets the zero of the encoder.

        After the call, the encoder reads ``counts`` at the joint position of ``state``.
        """
        self._zero = state.position - counts / self.counts_per_radian

    def jump(self, angle: float) -> None:
        """Adds ``angle`` (rad at the joint) to the joint position that the encoder reads."""
        self._zero -= angle

    def joint_position(self, counted: float) -> float:
        """Returns the true joint position (rad) for the counted position ``counted`` (rad)."""
        return counted + self._zero

    def measure(self, state: MotorState) -> tuple[float, float]:
        """Returns the joint position (rad) and joint speed (rad/s) that the encoder measures."""
        if not self.frozen:
            wrong = None if self.noise is None else self.noise()
            self._last = (state.position - self._zero, state.velocity if wrong is None else wrong)
        return self._last if not self.frozen else (self._last[0], 0.0)


def ideal_motor(robot: Robot, actuator: Actuator, wheels: DrivenWheels | None = None) -> IdealMotor:
    """Returns an ideal motor for an actuator of a robot.

    If the joint has limits, the motor has mechanical stops at half a turn in both directions.
    ``wheels`` are the other driven wheels of the robot, which a driven wheel joins.
    """
    joint = robot.joint(actuator.joint)
    wheel = next((w for w in robot.wheels if w.spin_joint == actuator.joint), None)
    motor = IdealMotor(
        actuator.max_velocity,
        actuator.max_acceleration,
        actuator.max_torque,
        -math.inf if joint.lower is None else min(joint.lower, -STOP),
        math.inf if joint.upper is None else max(joint.upper, STOP),
        coasting=coasting_of(robot, actuator),
        wheels=wheels if wheel is not None else None,
    )
    if wheels is not None and wheel is not None:
        wheels.add(motor, wheel.radius)
    return motor
