"""A simulated base with ideal joints, without mass and without ground."""

from __future__ import annotations

from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry

MAX_STEP = 0.5
"""Longest time (s) between two reads in which the base moves.

After a longer time, the base assumes that the driver was suspended."""


class SimBase(BaseHandle):
    """A simulated base whose joints follow the commands within the limits of the joints.

    The maximum acceleration limits the change of the wheel speeds.  The maximum steering rate
    limits the change of the steering angles.  A call ``read(now)`` moves the joints from the time
    of the last call to the time ``now``.  A wheel without a motor does not turn.

    >>> import thorvaldc
    >>> robot = thorvaldc.load("examples/4wd4ws_wide/robot.yaml")
    >>> driver = thorvaldc.BaseDriver(robot, thorvaldc.SimBase(robot))
    >>> for tick in range(100):
    ...     accepted = driver.command(thorvaldc.Twist(0.5, 0.0, 0.0), now=tick * 0.02)
    ...     state = driver.tick(tick * 0.02)
    >>> round(state.ramped.vx, 3)  # m/s
    0.5
    """

    def __init__(self, robot: Robot, start: float = 0.0) -> None:
        """Creates a base at rest at the time ``start`` (s)."""
        self._wheels = BaseGeometry.from_robot(robot).wheels
        n = len(self._wheels)
        self._time = start
        self._commands = JointCommands([0.0] * n, [0.0] * n)
        self._speeds = [0.0] * n
        self._positions = [0.0] * n
        self._angles = [0.0] * n
        self._rates = [0.0] * n

    def __repr__(self) -> str:
        return f"<SimBase: {len(self._wheels)} wheels, {self._time:g} s>"

    def read(self, now: float) -> JointStates:
        """Returns the joint states at the time ``now`` (s): rad, rad/s, one value per wheel."""
        dt = now - self._time
        if 0.0 < dt <= MAX_STEP:
            self._advance(dt)
        self._time = max(now, self._time)
        return JointStates(
            self._time,
            tuple(self._speeds),
            tuple(self._angles),
            tuple(self._rates),
            tuple(self._positions),
        )

    def write(self, commands: JointCommands, now: float) -> None:
        """Commands wheel speeds (rad/s) and steering angles (rad) from the time ``now`` (s) on."""
        self._commands = commands

    def _advance(self, dt: float) -> None:
        for i, wheel in enumerate(self._wheels):
            if wheel.driven:
                goal = min(max(self._commands.speeds[i], -wheel.max_speed), wheel.max_speed)
                start = self._speeds[i]
                step = wheel.max_acceleration * dt
                end = min(max(goal, start - step), start + step)
                # The joint speed changes linearly for `ramp` s and is then constant.  The joint
                # position is the integral of the joint speed.
                ramp = min(abs(end - start) / wheel.max_acceleration, dt)
                self._positions[i] += (start + end) / 2.0 * ramp + end * (dt - ramp)
                self._speeds[i] = end
            if wheel.steered:
                goal = self._commands.angles[i]
                if wheel.lower is not None:
                    goal = max(goal, wheel.lower)
                if wheel.upper is not None:
                    goal = min(goal, wheel.upper)
                start = self._angles[i]
                step = wheel.max_rate * dt
                self._angles[i] = min(max(goal, start - step), start + step)
                self._rates[i] = (self._angles[i] - start) / dt
