"""A base calculator that passes joint commands on, for experiments that command the joints."""

from __future__ import annotations

import math
from typing import Final

from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, TwistEstimate
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_STOPPING_TIME: Final = 0.15
"""Time constant (s) with which a commanded steering angle approaches its target."""


class DirectCommands(BaseCalculator):
    """A base calculator that returns its joint commands for every twist.

    The base calculator ``odometer`` computes the odometry.
    """

    name = "direct"
    summary = "joint commands of an episode"

    def __init__(
        self, robot: Robot, odometer: BaseCalculator, states: JointStates | None = None
    ) -> None:
        """Begins with joints at rest, at the angles of ``states`` or at 0."""
        super().__init__(odometer.geometry, odometer.options, odometer.noise)
        self.estimator = odometer.estimator
        self.odometer = odometer
        n = len(robot.wheels)
        self._angles = [0.0] * n if states is None else list(states.angles)
        self._commands = JointCommands([0.0] * n, list(self._angles))
        self._limits: list[tuple[float, float]] = []
        for wheel in robot.wheels:
            joint = None if wheel.steering_joint is None else robot.joint(wheel.steering_joint)
            lower = -math.inf if joint is None or joint.lower is None else joint.lower
            upper = math.inf if joint is None or joint.upper is None else joint.upper
            self._limits.append((lower, upper))

    def set(self, commands: JointCommands) -> None:
        """Sets the joint commands; an angle beyond its steering limit is clipped.

        Raises ``ValueError`` if there is not one finite speed and angle for each wheel.
        """
        speeds, angles = list(map(float, commands.speeds)), list(map(float, commands.angles))
        n = len(self._limits)
        if not (len(speeds) == len(angles) == n and all(map(math.isfinite, speeds + angles))):
            raise ValueError(f"joint commands must have {n} finite speeds and {n} finite angles")
        angles = [
            min(max(angle, lower), upper)
            for angle, (lower, upper) in zip(angles, self._limits, strict=True)
        ]
        self._commands = JointCommands(speeds, angles)

    def _steer(self, dt: float | None) -> None:
        """Moves the commanded steering angles towards their targets.

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
        self._steer(dt)
        joints = JointCommands(tuple(self._commands.speeds), tuple(self._angles))
        return BaseCommand(joints, ZERO_TWIST, ZERO_TWIST, ZERO_TWIST, 1.0, ())

    def stop(self, dt: float, measured: JointStates | None = None) -> BaseCommand:
        """Goes on with the joint commands, which no twist stops."""
        return self.command(ZERO_TWIST, measured, dt)

    def odometry(self, states: JointStates) -> TwistEstimate:
        return self.odometer.odometry(states)

    def reset(self, states: JointStates | None = None) -> None:
        self.odometer.reset(states)
