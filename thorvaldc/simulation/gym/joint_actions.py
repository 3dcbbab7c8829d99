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

    def feasible(self, twist: Twist) -> Twist:
        return twist

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        joints = JointCommands(tuple(self._commands.speeds), tuple(self._commands.angles))
        return BaseCommand(joints, ZERO_TWIST, ZERO_TWIST, ZERO_TWIST, 1.0, ())

    def odometry(self, states: JointStates) -> TwistEstimate:
        return self._odometer.odometry(states)

    def reset(self, states: JointStates | None = None) -> None:
        self._odometer.reset(states)
