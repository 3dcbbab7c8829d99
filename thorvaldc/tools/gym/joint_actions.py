"""Conversion of the actions of a Gymnasium environment to joint commands."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, TwistEstimate
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

Array = NDArray[np.float64]

_STOPPING_TIME = 0.15
"""Time constant (s) with which a commanded steering angle approaches its target."""


class JointActions:
    """Converts an action of a Gymnasium environment to joint commands.

    Each value of an action is between -1 and 1.  The first values of an action are the speeds of
    the driven wheels, and the other values are the angles of the steered wheels.
    """

    def __init__(self, robot: Robot) -> None:
        n = len(robot.wheels)
        self.commands = JointCommands([0.0] * n, [0.0] * n)
        # ``driven`` has (wheel, largest speed in rad/s) for each driven wheel.  ``steered`` has
        # (wheel, scale, lower limit, upper limit) in rad for each steered wheel.
        self.driven: list[tuple[int, float]] = []
        self.steered: list[tuple[int, float, float, float]] = []
        for i, wheel in enumerate(robot.wheels):
            motor = robot.actuator_of(wheel.spin_joint)
            if wheel.driven and motor is not None:
                self.driven.append((i, motor.max_velocity))
            if wheel.steering_joint is not None:
                joint = robot.joint(wheel.steering_joint)
                lower = -math.inf if joint.lower is None else joint.lower
                upper = math.inf if joint.upper is None else joint.upper
                scale = max(abs(lower), abs(upper))
                scale = scale if math.isfinite(scale) else math.pi
                self.steered.append((i, scale, lower, upper))

    def reset(self) -> None:
        """Sets all joint commands to zero."""
        n = len(self.commands.speeds)
        self.commands.speeds, self.commands.angles = [0.0] * n, [0.0] * n

    def set(self, action: Array) -> None:
        """Sets the joint commands to the values of an action."""
        speeds, angles = list(self.commands.speeds), list(self.commands.angles)
        values = action.tolist()
        for (i, largest), value in zip(self.driven, values, strict=False):
            speeds[i] = value * largest
        for (i, scale, lower, upper), value in zip(
            self.steered, values[len(self.driven) :], strict=True
        ):
            angles[i] = min(max(value * scale, lower), upper)
        self.commands.speeds, self.commands.angles = speeds, angles


class DirectCommands(BaseCalculator):
    """A base calculator that returns the joint commands of an action for every twist.

    The base calculator ``odometer`` computes the odometry.
    """

    name = "direct"
    summary = "joint commands of an environment"

    def __init__(self, odometer: BaseCalculator, commands: JointCommands) -> None:
        super().__init__(odometer.geometry, odometer.options, odometer.noise)
        self.estimator = odometer.estimator
        self._odometer = odometer
        self._commands = commands
        self._angles = list(commands.angles)

    def _steer(self, states: JointStates | None, dt: float | None) -> None:
        """Moves the commanded steering angles towards the angles of the action.

        The rate of a commanded angle is limited to the largest rate of the steering motor, and near
        the target to the rate from which the motor can stop.  A step of the commanded angle would
        make the wheel overshoot its steering limit.
        """
        for i, wheel in enumerate(self.geometry.wheels):
            distance = self._commands.angles[i] - self._angles[i]
            if dt is None or not wheel.steered:
                step = abs(distance)
            else:
                step = min(wheel.max_rate, abs(distance) / _STOPPING_TIME) * dt
            self._angles[i] += min(max(distance, -step), step)

    def feasible(self, twist: Twist) -> Twist:
        return twist

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._steer(states, dt)
        joints = JointCommands(tuple(self._commands.speeds), tuple(self._angles))
        return BaseCommand(joints, ZERO_TWIST, ZERO_TWIST, ZERO_TWIST, 1.0, ())

    def odometry(self, states: JointStates) -> TwistEstimate:
        return self._odometer.odometry(states)

    def reset(self, states: JointStates | None = None) -> None:
        self._odometer.reset(states)
