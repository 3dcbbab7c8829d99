"""The forces on a robot that drives or stands straight up or down a slope.

The robot is rigid and has all joints at position 0. On a slope of the angle a, the weight W has the
component W cos(a) into the ground and W sin(a) downhill. The centre of mass at the height h then
loads the wheels as if it were above a point that is h tan(a) further downhill, which gives the
wheel loads N_i (see ``static_loads``). Force that moves the robot uphill at a constant speed, with
the coefficients of rolling resistance c_i:

    F = W sin(a) + sum over wheels c_i N_i.

The motors push with at most the sum of torque over radius of the driven wheels. The grip of the
driven wheels with the coefficients of friction mu_i is sum mu_i N_i. The loads of a robot with
rockers leave out the moments that the driving forces have about the rockers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.robot import Robot
from thorvaldc.model.statics.contact_point import contact_point
from thorvaldc.model.statics.gravity import GRAVITY
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.passive_joints import held_joints
from thorvaldc.model.statics.standing import standing_of
from thorvaldc.model.statics.static_loads import Pivot, free_pivots, static_loads
from thorvaldc.model.stopping import driven_wheels

_STEP, _STEEPEST = math.radians(10.0), math.radians(80.0)
_TOLERANCE = 1e-12  # rad
_MAX_ITERATIONS = 60


class SlopeForces(NamedTuple):
    """Forces on a robot on a slope in N.

    - ``needed``: force that moves the robot uphill at a constant speed.
    - ``motors``: largest force of the motors.
    - ``grip``: largest friction force of the driven wheels.
    """

    needed: float
    motors: float
    grip: float


class SlopeStatics:
    """The forces on one robot on slopes of any angle, driving forwards or backwards uphill."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._points = [contact_point(wheel) for wheel in robot.wheels]
        standing = standing_of(robot)
        stopped = held_joints(robot) | (standing.at_limit if standing is not None else frozenset())
        self._pivots: list[Pivot] = free_pivots(tree_of(robot), robot.wheels, stopped)
        driven = driven_wheels(robot.wheels, robot.actuators)
        self._motors = float_sum(motor.max_torque / wheel.radius for wheel, motor in driven)

    def loads(self, angle: float, *, backwards: bool = False) -> list[float]:
        """Return the wheel loads in N on a slope of ``angle`` rad."""
        body = self._robot.inertial
        x, y, z = body.com
        downhill = 1.0 if backwards else -1.0
        shifted = replace(body, com=(x + downhill * z * math.tan(angle), y, z))
        return [
            load * math.cos(angle) for load in static_loads(self._points, shifted, self._pivots)
        ]

    def forces(self, angle: float, *, backwards: bool = False) -> SlopeForces:
        """Return the forces on the robot on a slope of ``angle`` rad, below a right angle."""
        loads = self.loads(angle, backwards=backwards)
        wheels = list(zip(self._robot.wheels, loads, strict=True))
        weight = self._robot.inertial.mass * GRAVITY
        rolling = float_sum(wheel.rolling_resistance * load for wheel, load in wheels)
        grip = float_sum(wheel.friction * load for wheel, load in wheels if wheel.driven)
        return SlopeForces(weight * math.sin(angle) + rolling, self._motors, grip)


def steepest_angle(excess: Callable[[float], float]) -> float | None:
    """Return the angle in rad from which on a force is too small.

    Returns ``None`` if the force is large enough up to 80 degrees.

    ``excess`` is the force minus the needed force as a function of the angle. The Illinois
    algorithm finds the zero in the first step of ``_STEP`` in which the excess becomes negative.
    """
    low, high = 0.0, 0.0
    excess_low = excess(low)
    if excess_low < 0.0:
        return 0.0
    while True:
        high = low + _STEP
        if high > _STEEPEST:
            return None
        excess_high = excess(high)
        if excess_high < 0.0:
            break
        low, excess_low = high, excess_high
    side, previous = 0, high
    for _ in range(_MAX_ITERATIONS):
        middle = (low * excess_high - high * excess_low) / (excess_high - excess_low)
        if abs(middle - previous) < _TOLERANCE:
            break
        previous, value = middle, excess(middle)
        if value >= 0.0:
            low, excess_low = middle, value
            excess_high = excess_high / 2.0 if side > 0 else excess_high
            side = 1
        else:
            high, excess_high = middle, value
            excess_low = excess_low / 2.0 if side < 0 else excess_low
            side = -1
    return previous
