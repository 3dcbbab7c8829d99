"""A base of ideal joints: no mass, no ground, only the joints' own limits."""

from __future__ import annotations

from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry

GAP = 0.5
"""Time (s) between two reads beyond which the base is taken to have stood still."""


class SimBase(BaseHandle):
    """Wheels ramp by their maximum acceleration, steering slews by its maximum speed.

    Moves on when it is read.  Wheels without a motor stay at 0.
    """

    def __init__(self, robot: Robot, start: float = 0.0) -> None:
        self._wheels = BaseGeometry.from_robot(robot).wheels
        n = len(self._wheels)
        self._time = start
        self._commands = JointCommands([0.0] * n, [0.0] * n)
        self._speeds = [0.0] * n
        self._positions = [0.0] * n
        self._angles = [0.0] * n
        self._rates = [0.0] * n

    def read(self, now: float) -> JointStates:
        dt = now - self._time
        if 0.0 < dt <= GAP:
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
        self._commands = commands

    def _advance(self, dt: float) -> None:
        for i, wheel in enumerate(self._wheels):
            if wheel.driven:
                asked = min(max(self._commands.speeds[i], -wheel.max_speed), wheel.max_speed)
                before = self._speeds[i]
                step = wheel.max_acceleration * dt
                after = min(max(asked, before - step), before + step)
                # The ramp takes part of the interval, the speed reached the rest of it.
                ramp = min(abs(after - before) / wheel.max_acceleration, dt)
                self._positions[i] += (before + after) / 2.0 * ramp + after * (dt - ramp)
                self._speeds[i] = after
            if wheel.steered:
                asked = self._commands.angles[i]
                if wheel.lower is not None:
                    asked = max(asked, wheel.lower)
                if wheel.upper is not None:
                    asked = min(asked, wheel.upper)
                before = self._angles[i]
                step = wheel.max_rate * dt
                self._angles[i] = min(max(asked, before - step), before + step)
                self._rates[i] = (self._angles[i] - before) / dt
