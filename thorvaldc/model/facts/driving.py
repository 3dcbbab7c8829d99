"""Top speeds and the tightest turn of a robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.robot import Robot
from thorvaldc.model.statics.contact_point import contact_point
from thorvaldc.model.statics.footprint import footprint
from thorvaldc.model.statics.mobility import (
    Center,
    Twist,
    cannot_turn,
    feasible_twists,
    roll_speeds,
    tightest_turn,
)
from thorvaldc.model.stopping import driven_wheels

FORWARDS, SIDEWAYS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Turn:
    """The tightest turn of a robot.

    - ``x``, ``y``: centre of rotation in ``base_link`` in m.
    - ``radius``: distance of the centre from the origin of ``base_link`` in m.
    - ``wheel_circle``: diameter in m of the circle that contains the paths of the contact points.
    - ``outer_circle``: diameter in m of the circle that contains the footprint of the robot.
    - ``yaw_rate``: highest yaw rate in this turn in rad/s.
    - ``skids``: true if the robot turns only with side slip of its fixed wheels.
    """

    x: si.Metres
    y: si.Metres
    radius: si.Metres
    wheel_circle: si.Metres
    outer_circle: si.Metres
    yaw_rate: si.RadiansPerSecond
    skids: bool


@dataclass(frozen=True, slots=True)
class Driving:
    """Top speeds of a robot within the limits of its base driver and of its motors.

    - ``forwards``, ``sideways``: top speeds in m/s; ``sideways`` is 0 for a robot whose wheels do
      not roll sideways.
    - ``acceleration``: largest acceleration of the base driver in m/s^2.
    - ``turn``: the tightest turn, or ``None`` if the robot cannot turn.
    """

    forwards: si.MetresPerSecond
    sideways: si.MetresPerSecond
    acceleration: si.MetresPerSecond2
    turn: Turn | None


def driving_of(robot: Robot) -> Driving:
    """Return the top speeds and the tightest turn of a robot."""
    return Driving(
        forwards=_top_speed(robot, FORWARDS),
        sideways=_top_speed(robot, SIDEWAYS),
        acceleration=robot.driver.max_linear_acceleration,
        turn=_turn(robot),
    )


def _top_speed(robot: Robot, direction: Twist) -> float:
    """Return the top speed in m/s in a direction, 0 if the wheels do not roll in this direction.

    The wheels of a robot that does not turn have its speed, so the limit of the base driver, which
    the slowest wheel determines, holds for every direction.
    """
    driven = any(wheel.driven for wheel in robot.wheels)
    allowed = driven and roll_speeds(robot, direction) is not None
    return robot.driver.max_linear_velocity if allowed else 0.0


def _turn(robot: Robot) -> Turn | None:
    if not any(wheel.driven for wheel in robot.wheels):
        return None
    skids = feasible_twists(robot) == 1 and cannot_turn(robot)
    center = (0.0, 0.0) if skids else tightest_turn(robot)
    if center is None:
        return None
    x, y = center
    paths = [math.dist(center, contact_point(wheel)) for wheel in robot.wheels]
    corners = [math.dist(center, corner) for corner in footprint(robot)]
    return Turn(
        x=x,
        y=y,
        radius=math.hypot(x, y),
        wheel_circle=2.0 * max(paths),
        outer_circle=2.0 * max([*paths, *corners]),
        yaw_rate=_yaw_rate(robot, center),
        skids=skids,
    )


def _yaw_rate(robot: Robot, center: Center) -> float:
    """Return the highest yaw rate in rad/s about a centre of rotation.

    The limits are those of the base driver for the velocity of ``base_link`` and for the yaw rate,
    and the speed of each driven wheel. A wheel of a robot that skids counts with its lever.
    """
    x, y = center
    limit = robot.driver.max_angular_velocity
    radius = math.hypot(x, y)
    if radius * limit > robot.driver.max_linear_velocity:
        limit = robot.driver.max_linear_velocity / radius
    speeds = roll_speeds(robot, (y, -x, 1.0))
    for wheel, motor in driven_wheels(robot.wheels, robot.actuators):
        lever = (
            abs(speeds[wheel.name])
            if speeds is not None and wheel.name in speeds
            else math.dist(center, contact_point(wheel))
        )
        if lever * limit > motor.max_velocity * wheel.radius:
            limit = motor.max_velocity * wheel.radius / lever
    return limit
