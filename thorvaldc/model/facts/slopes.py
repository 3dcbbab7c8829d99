"""The steepest slopes that a robot climbs, and on which it stops."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.facts.stability import DIRECTIONS
from thorvaldc.model.robot import Robot
from thorvaldc.model.statics.slope import SlopeForces, SlopeStatics, steepest_angle
from thorvaldc.model.statics.stopping_slope import steepest_stops
from thorvaldc.model.statics.tip_over import support_of


@dataclass(frozen=True, slots=True)
class SlopeLimits:
    """The steepest slopes in rad that a robot climbs straight up at a constant low speed.

    ``model.statics.slope`` states the formulas and the assumptions, ``stopping_slope`` those of
    ``stops``.

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
    """The steepest slopes that a robot climbs and on which it stops, forwards and backwards.

    - ``friction``: smallest and largest coefficient of friction of the driven wheels.
    - ``rolling_resistance``: smallest and largest coefficient of rolling resistance of all wheels.
    """

    forwards: SlopeLimits
    backwards: SlopeLimits
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
    statics = SlopeStatics(robot)
    return Slopes(
        _limits(robot, statics, backwards=False),
        _limits(robot, statics, backwards=True),
        (min(friction), max(friction)),
        (min(rolling), max(rolling)),
    )


def _limits(robot: Robot, statics: SlopeStatics, *, backwards: bool) -> SlopeLimits:
    @functools.cache
    def forces(angle: float) -> SlopeForces:
        return statics.forces(angle, backwards=backwards)

    downhill = DIRECTIONS["front" if backwards else "rear"]
    limits = {
        "grip": steepest_angle(lambda angle: forces(angle).grip - forces(angle).needed),
        "torque": steepest_angle(lambda angle: forces(angle).motors - forces(angle).needed),
        "tip_over": support_of(robot).tip_over_angle(downhill),
    }
    known = {name: angle for name, angle in limits.items() if angle is not None}
    reason = min(known, key=lambda name: known[name])
    return SlopeLimits(
        limits["grip"],
        limits["torque"],
        known["tip_over"],
        known[reason],
        reason,
        steepest_stops(robot)[backwards],
    )
