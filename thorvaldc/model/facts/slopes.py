"""The steepest slopes that a robot climbs."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

from thorvaldc.model.facts.stability import DIRECTIONS
from thorvaldc.model.robot import Robot
from thorvaldc.model.statics.slope import SlopeForces, SlopeStatics
from thorvaldc.model.statics.tip_over import support_of

_STEP, _STEEPEST = math.radians(10.0), math.radians(80.0)
_TOLERANCE = 1e-12  # rad
_MAX_ITERATIONS = 60


@dataclass(frozen=True, slots=True)
class SlopeLimits:
    """The steepest slopes in rad that a robot climbs straight up at a constant low speed.

    ``model.statics.slope`` states the formulas and the assumptions.

    - ``grip``: slope at which the driven wheels slip, or ``None`` if it is steeper than 80 degrees.
    - ``torque``: slope at which the motors stall, at their largest torque, or ``None`` if it is
      steeper than 80 degrees.
    - ``tip_over``: slope at which the robot tips over downhill.
    - ``steepest``: the smallest of the three.
    - ``reason``: name of the smallest: ``grip``, ``torque`` or ``tip_over``.
    """

    grip: float | None
    torque: float | None
    tip_over: float
    steepest: float
    reason: str


@dataclass(frozen=True, slots=True)
class Slopes:
    """The steepest slopes that a robot climbs, forwards and backwards.

    - ``friction``: smallest and largest coefficient of friction of the driven wheels.
    - ``rolling_resistance``: smallest and largest coefficient of rolling resistance of all wheels.
    """

    forwards: SlopeLimits
    backwards: SlopeLimits
    friction: tuple[float, float]
    rolling_resistance: tuple[float, float]


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
        "grip": _zero(lambda angle: forces(angle).grip - forces(angle).needed),
        "torque": _zero(lambda angle: forces(angle).motors - forces(angle).needed),
        "tip_over": support_of(robot).tip_over_angle(downhill),
    }
    known = {name: angle for name, angle in limits.items() if angle is not None}
    reason = min(known, key=lambda name: known[name])
    return SlopeLimits(limits["grip"], limits["torque"], known["tip_over"], known[reason], reason)


def _zero(excess: Callable[[float], float]) -> float | None:
    """Return the angle in rad from which on a force is too small, or ``None`` if it never is.

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
