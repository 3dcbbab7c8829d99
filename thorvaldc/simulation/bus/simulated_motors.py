"""Motors as a controller on the bus sees them: ideal ones, or the joints of a simulated base."""

from __future__ import annotations

import abc
import math
from typing import NamedTuple

from thorvaldc.model import Actuator, Joint, Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates

POSITION_GAIN = 10.0
"""1/s: speed asked of a speed-controlled joint for its distance from a position."""

LEAD = 0.2
"""rad: how far a position asked for runs ahead of a joint that is held up."""
STOP = math.pi
"""rad: where a joint that is limited to less has its mechanical stops, to either side."""


class MotorState(NamedTuple):
    """At the joint: rad (not wrapped), rad/s, N m."""

    position: float
    velocity: float
    torque: float


class MotorModel(abc.ABC):
    """A motor with its gear on a joint: rad and rad/s of the joint, N m at the joint.

    Times are s and never go back.  What was asked last is followed until something
    else is asked.  ``blocked``: nothing moves it.
    """

    blocked = False

    @abc.abstractmethod
    def read(self, now: float) -> MotorState:
        """How the joint moves at ``now``."""

    @abc.abstractmethod
    def turn(self, velocity: float, now: float) -> None:
        """Turn at that speed, which is reached as fast as the motor can."""

    @abc.abstractmethod
    def hold(self, position: float, now: float) -> None:
        """Go to that position as fast as the motor can and stay."""

    @abc.abstractmethod
    def release(self, now: float) -> None:
        """Power stage off: no torque."""


class IdealMotor(MotorModel):
    """No mass: speeds ramp by ``max_acceleration``, positions slew by ``max_velocity``.

    ``lower`` and ``upper`` (rad) are mechanical stops.
    """

    def __init__(
        self,
        max_velocity: float,
        max_acceleration: float,
        max_torque: float = 0.0,
        lower: float = -math.inf,
        upper: float = math.inf,
        position: float = 0.0,
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

    def read(self, now: float) -> MotorState:
        self._advance(now)
        return MotorState(self._position, self._velocity, self._torque)

    def turn(self, velocity: float, now: float) -> None:
        self._advance(now)
        self._speed, self._goal = velocity, None

    def hold(self, position: float, now: float) -> None:
        self._advance(now)
        self._speed, self._goal = None, position

    def release(self, now: float) -> None:
        """Ideal wheels have no inertia to coast with: they stop as they would by themselves."""
        self._advance(now)
        self._speed, self._goal = 0.0, None

    def _advance(self, now: float) -> None:
        dt = now - self._time
        if dt <= 0.0:
            return
        self._time = now
        before, speed = self._position, self._velocity
        if self._goal is not None:
            reach = self.max_velocity * dt
            way = min(max(self._goal - before, -reach), reach)
            after, self._velocity = before + way, way / dt
            self._torque = 0.0
        else:
            limit = self.max_velocity
            asked = min(max(self._speed or 0.0, -limit), limit)
            step = self.max_acceleration * dt
            self._velocity = min(max(asked, speed - step), speed + step)
            # The ramp takes part of the interval, the speed reached the rest of it.
            ramp = min(abs(self._velocity - speed) / self.max_acceleration, dt)
            after = before + (speed + self._velocity) / 2.0 * ramp + self._velocity * (dt - ramp)
            share = (self._velocity - speed) / step
            self._torque = share * self.max_torque
        held = min(max(after, self.lower), self.upper)
        if self.blocked or held != after:
            push = after - before
            self._torque = math.copysign(self.max_torque, push) if push else 0.0
            self._velocity = 0.0
            held = before if self.blocked else held
        self._position = held


class BaseMotors:
    """The motors of a robot's base, ideal or in MuJoCo, one model for each actuator.

    Reads and commands of all of them go through one ``BaseHandle``, which moves on
    when it is read.  A released motor is asked to stand still: the base has no other
    way to say it.
    """

    def __init__(self, robot: Robot, base: BaseHandle) -> None:
        self.base = base
        base.expect_single_commands()
        n = len(robot.wheels)
        self._commands = JointCommands([0.0] * n, [0.0] * n)
        self._states: JointStates | None = None
        self._read_at = -1.0
        self._places: dict[str, tuple[int, bool]] = {}
        for i, wheel in enumerate(robot.wheels):
            self._places[wheel.spin_joint] = (i, False)
            if wheel.steering_joint is not None:
                self._places[wheel.steering_joint] = (i, True)

    def motor(self, actuator: Actuator) -> MotorModel | None:
        """The model of a motor of the base, ``None`` where it moves none of the wheels."""
        place = self._places.get(actuator.joint)
        return None if place is None else _BaseMotor(self, *place)

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


class _BaseMotor(MotorModel):
    def __init__(self, motors: BaseMotors, wheel: int, steering: bool) -> None:
        self._motors = motors
        self._wheel = wheel
        self._steering = steering
        self._asked: float | None = None
        self._turning: tuple[float, float] | None = None

    def read(self, now: float) -> MotorState:
        states, i = self._motors.states(now), self._wheel
        if self._steering:
            if self._turning is not None:
                self._turn_on(now)
            return MotorState(states.angles[i], states.angle_rates[i], 0.0)
        position = states.positions[i] if states.positions is not None else 0.0
        return MotorState(position, states.speeds[i], 0.0)

    def turn(self, velocity: float, now: float) -> None:
        if not self._steering:
            self._write(velocity, now)
            return
        # The joint is controlled by position: the position asked for moves on.
        if self._turning is None:
            self._asked = self.read(now).position
        else:
            self._turn_on(now)
        self._turning = (velocity, now)

    def hold(self, position: float, now: float) -> None:
        self._turning = None
        if self._steering:
            self._write(position, now)
        else:
            self._write(POSITION_GAIN * (position - self.read(now).position), now)

    def release(self, now: float) -> None:
        if self._steering:
            self._turning = None
            self._write(self.read(now).position, now)
        else:
            self._write(0.0, now)

    def _turn_on(self, now: float) -> None:
        if self._turning is not None and self._asked is not None:
            velocity, since = self._turning
            self._turning = (velocity, now)
            here = self._motors.states(now).angles[self._wheel]
            asked = self._asked + velocity * (now - since)
            self._write(min(max(asked, here - LEAD), here + LEAD), now)

    def _write(self, value: float, now: float) -> None:
        if self.blocked:  # as near as a base can come to it: it is asked to stay
            value = self._motors.states(now).angles[self._wheel] if self._steering else 0.0
        if value != self._asked:
            self._asked = value
            self._motors.write(self._wheel, self._steering, value, now)


class Encoder:
    """Counts of a motor's shaft, four for each pulse, from where it was switched on.

    ``frozen``: it stays at what it counted last.
    """

    def __init__(self, gear_ratio: float, pulses: int) -> None:
        self.gear_ratio = gear_ratio
        self.pulses = pulses
        self.frozen = False
        self._zero = 0.0
        self._last = (0.0, 0.0)

    @property
    def counts_per_radian(self) -> float:
        """Counts for one rad of the joint."""
        return 4.0 * self.pulses * self.gear_ratio / math.tau

    def set_zero(self, state: MotorState, counts: float = 0.0) -> None:
        """From now on this position of the joint counts as ``counts``."""
        self._zero = state.position - counts / self.counts_per_radian

    def joint_position(self, counted: float) -> float:
        """Where the joint really is for a position as it is counted, rad."""
        return counted + self._zero

    def measure(self, state: MotorState) -> tuple[float, float]:
        """Position and speed of the joint as they are counted, rad and rad/s."""
        if not self.frozen:
            self._last = (state.position - self._zero, state.velocity)
        return self._last if not self.frozen else (self._last[0], 0.0)


def ideal_motor(actuator: Actuator, joint: Joint) -> IdealMotor:
    """The motor of an actuator; a joint with limits has stops half a turn to either side."""
    return IdealMotor(
        actuator.max_velocity,
        actuator.max_acceleration,
        actuator.max_torque,
        -math.inf if joint.lower is None else min(joint.lower, -STOP),
        math.inf if joint.upper is None else max(joint.upper, STOP),
    )
