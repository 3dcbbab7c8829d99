"""A simulated base with ideal joints, without mass and without ground."""

from __future__ import annotations

import math

from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.simulation.physics.coasting import Coasting, coasting_of
from thorvaldc.simulation.physics.simulated_joints import SimulatedJoints

MAX_STEP = 0.5
"""Longest time (s) between two reads in which the base moves.

After a longer time, the base assumes that the driver was suspended."""


class SimBase(SimulatedJoints):
    """A simulated base whose joints follow the commands within the limits of the joints.

    The maximum acceleration limits the change of the wheel speeds.  The maximum steering rate
    limits the change of the steering angles.  A call ``read(now)`` moves the joints from the time
    of the last call to the time ``now``.  A wheel without a motor does not turn.  A joint whose
    motor has no power rolls out (``coasting``).  The ground couples the wheels: a wheel without
    power rolls no faster than the fastest wheel with power.

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
        self._coasting: dict[tuple[int, bool], Coasting] = {}
        for i, wheel in enumerate(robot.wheels):
            for joint in (wheel.spin_joint, wheel.steering_joint):
                motor = robot.actuator_of(joint) if joint is not None else None
                if motor is not None:
                    self._coasting[i, joint == wheel.steering_joint] = coasting_of(robot, motor)
        self._off_since: dict[tuple[int, bool], float] = {}
        """Time (s) at which each motor without power has lost it, by (wheel, steering)."""

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

    def switch_motor(self, wheel: int, steering: bool, on: bool, now: float) -> None:
        self.read(now)
        if on:
            self._off_since.pop((wheel, steering), None)
        else:
            self._off_since.setdefault((wheel, steering), now)

    def _advance(self, dt: float) -> None:
        if self._off_since:
            self._roll_out(dt)
        for i, wheel in enumerate(self._wheels):
            if wheel.driven and (i, False) not in self._off_since:
                goal = min(max(self._commands.speeds[i], -wheel.max_speed), wheel.max_speed)
                start = self._speeds[i]
                step = wheel.max_acceleration * dt
                end = min(max(goal, start - step), start + step)
                # The joint speed changes linearly for `ramp` s and is then constant.  The joint
                # position is the integral of the joint speed.
                ramp = min(abs(end - start) / wheel.max_acceleration, dt)
                self._positions[i] += (start + end) / 2.0 * ramp + end * (dt - ramp)
                self._speeds[i] = end
            if wheel.steered and (i, True) not in self._off_since:
                goal = self._commands.angles[i]
                if wheel.lower is not None:
                    goal = max(goal, wheel.lower)
                if wheel.upper is not None:
                    goal = min(goal, wheel.upper)
                start = self._angles[i]
                step = wheel.max_rate * dt
                self._angles[i] = min(max(goal, start - step), start + step)
                self._rates[i] = (self._angles[i] - start) / dt

    def _roll_out(self, dt: float) -> None:
        """Moves the joints whose motors have no power."""
        fastest = self._fastest_with_power()
        for (i, steering), since in self._off_since.items():
            coasting = self._coasting[i, steering]
            speeds, positions = (
                (self._rates, self._angles) if steering else (self._speeds, self._positions)
            )
            speed = speeds[i]
            if not steering:
                limit = fastest / self._wheels[i].radius
                speed = min(max(speed, -limit), limit)
            speeds[i], angle = coasting.roll(speed, self._time - since, dt)
            positions[i] += angle

    def _fastest_with_power(self) -> float:
        """Returns the speed (m/s) of the fastest wheel with power, infinite without one."""
        return max(
            (
                abs(self._speeds[i]) * wheel.radius
                for i, wheel in enumerate(self._wheels)
                if wheel.driven and (i, False) not in self._off_since
            ),
            default=math.inf,
        )
