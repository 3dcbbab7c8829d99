"""Top speeds, tightest turn and steepest slopes of a robot."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

from thorvaldc.model import Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.statics import mobility
from thorvaldc.model.statics.occupied_space import footprint
from thorvaldc.model.statics.slope import DIRECTIONS, SlopeForces, SlopeStatics, steepest_angle
from thorvaldc.model.statics.slope_stops import steepest_stops
from thorvaldc.model.statics.tip_over import support_of
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


def _top_speed(robot: Robot, direction: mobility.Twist) -> float:
    """Return the top speed in m/s in a direction, 0 if the wheels do not roll in this direction.

    The wheels of a robot that does not turn have its speed, so the limit of the base driver, which
    the slowest wheel determines, holds for every direction.
    """
    driven = any(wheel.driven for wheel in robot.wheels)
    allowed = driven and mobility.roll_speeds(robot, direction) is not None
    return robot.driver.max_linear_velocity if allowed else 0.0


def _turn(robot: Robot) -> Turn | None:
    if not any(wheel.driven for wheel in robot.wheels):
        return None
    skids = mobility.feasible_twists(robot) == 1 and mobility.cannot_turn(robot)
    center = (0.0, 0.0) if skids else mobility.tightest_turn(robot)
    if center is None:
        return None
    x, y = center
    paths = [math.dist(center, wheel.contact_point) for wheel in robot.wheels]
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


def _yaw_rate(robot: Robot, center: mobility.Center) -> float:
    """Return the highest yaw rate in rad/s about a centre of rotation.

    The limits are those of the base driver for the velocity of ``base_link`` and for the yaw rate,
    and the speed of each driven wheel. A wheel of a robot that skids counts with its lever.
    """
    x, y = center
    limit = robot.driver.max_angular_velocity
    radius = math.hypot(x, y)
    if radius * limit > robot.driver.max_linear_velocity:
        limit = robot.driver.max_linear_velocity / radius
    speeds = mobility.roll_speeds(robot, (y, -x, 1.0))
    for wheel, motor in driven_wheels(robot.wheels, robot.actuators):
        lever = (
            abs(speeds[wheel.name])
            if speeds is not None and wheel.name in speeds
            else math.dist(center, wheel.contact_point)
        )
        if lever * limit > motor.max_velocity * wheel.radius:
            limit = motor.max_velocity * wheel.radius / lever
    return limit


# -- the steepest slopes that a robot climbs, and on which it stops -----------------------------


@dataclass(frozen=True, slots=True)
class SlopeLimits:
    """The steepest slopes in rad that a robot climbs straight up at a constant low speed, and on
    which it stops while it drives downhill in the same direction.

    ``model.statics.slope`` states the formulas and the assumptions.

    - ``grip``: slope at which the driven wheels slip, or ``None`` if it is steeper than 80 degrees.
    - ``torque``: slope at which the motors stall, at their largest torque, or ``None`` if it is
      steeper than 80 degrees.
    - ``tip_over``: slope at which the robot tips over downhill.
    - ``steepest``: the smallest of the three.
    - ``reason``: name of the smallest: ``grip``, ``torque`` or ``tip_over``.
    - ``stops``: slope on which every stop keeps the stopping distance, or needs no longer than on
      level ground if none is stated, while the robot drives in this direction straight downhill
      at its top speed. The loss of a drive is one of the stops if the robot has others.
    """

    grip: si.Radians | None
    torque: si.Radians | None
    tip_over: si.Radians
    steepest: si.Radians
    reason: str
    stops: si.Radians


@dataclass(frozen=True, slots=True)
class Slopes:
    """The steepest slopes that a robot climbs and on which it stops, in each direction.

    - ``left``, ``right``: ``None`` for a robot whose wheels do not roll sideways.
    - ``friction``: smallest and largest coefficient of friction of the driven wheels.
    - ``rolling_resistance``: smallest and largest coefficient of rolling resistance of all wheels.
    """

    forwards: SlopeLimits
    backwards: SlopeLimits
    left: SlopeLimits | None
    right: SlopeLimits | None
    friction: tuple[si.Number, si.Number]
    rolling_resistance: tuple[si.Number, si.Number]


def slopes_of(robot: Robot) -> Slopes | None:
    """Return the steepest slopes of a robot, or ``None`` for a robot without driven wheels or one
    that does not stand."""
    driven = [wheel for wheel in robot.wheels if wheel.driven]
    if not driven or not support_of(robot).stands:
        return None
    friction = [wheel.friction for wheel in driven]
    rolling = [wheel.rolling_resistance for wheel in robot.wheels]
    limits = {name: _limits(robot, name, stops) for name, stops in steepest_stops(robot).items()}
    return Slopes(
        limits["forwards"],
        limits["backwards"],
        limits.get("left"),
        limits.get("right"),
        (min(friction), max(friction)),
        (min(rolling), max(rolling)),
    )


def _limits(robot: Robot, direction: str, stops: float) -> SlopeLimits:
    statics, (x, y) = SlopeStatics(robot), DIRECTIONS[direction]

    @functools.cache
    def forces(angle: float) -> SlopeForces:
        return statics.forces(angle, (x, y))

    limits = {
        "grip": steepest_angle(lambda angle: forces(angle).grip - forces(angle).needed),
        "torque": steepest_angle(lambda angle: forces(angle).motors - forces(angle).needed),
        "tip_over": support_of(robot).tip_over_angle(math.atan2(-y, -x)),
    }
    known = {name: angle for name, angle in limits.items() if angle is not None}
    reason = min(known, key=lambda name: known[name])
    return SlopeLimits(
        limits["grip"], limits["torque"], known["tip_over"], known[reason], reason, stops
    )
