"""A robot on a slope: the forces on it, and how it stands without power.

Forces on a robot that drives or stands straight up or down a slope. The robot is rigid and has all
joints at position 0. On a slope of the angle a, the weight W has the component W cos(a) into the
ground and W sin(a) downhill. The centre of mass at the height h then loads the wheels as if it were
above a point that is h tan(a) further downhill, which gives the wheel loads N_i (see
``static_loads``). Force that moves the robot uphill at a constant speed, with the coefficients of
rolling resistance c_i:

    F = W sin(a) + sum over wheels c_i N_i.

The motors push with at most the sum of torque over radius of the driven wheels. The grip of the
driven wheels with the coefficients of friction mu_i is sum mu_i N_i. The forces of the wheels along
the slope are in proportion to their loads; they turn rockers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from thorvaldc.model import Actuator, Joint, Robot, Wheel, stopping
from thorvaldc.model import quantities as si
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics import mobility
from thorvaldc.model.statics.ground_contacts import with_ground_contacts
from thorvaldc.model.statics.joint_tree import held_joints, tree_of
from thorvaldc.model.statics.standing import standing_of
from thorvaldc.model.statics.static_loads import free_pivots, static_loads
from thorvaldc.model.statics.tip_over import support_of
from thorvaldc.model.sums import float_sum

_STEP, _STEEPEST = math.radians(10.0), math.radians(80.0)
_TOLERANCE = 1e-12  # rad
_MAX_ITERATIONS = 60


Direction = tuple[float, float]
"""Horizontal unit vector in ``base_link``."""
DIRECTIONS: dict[str, Direction] = {
    "forwards": (1.0, 0.0),
    "backwards": (-1.0, 0.0),
    "left": (0.0, 1.0),
    "right": (0.0, -1.0),
}
FORWARDS = DIRECTIONS["forwards"]


def directions_of(robot: Robot) -> list[str]:
    """Return the names of the directions in which the wheels of a robot roll straight on."""
    sideways = mobility.roll_speeds(robot, (0.0, 1.0, 0.0)) is not None
    return list(DIRECTIONS)[: 4 if sideways else 2]


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
    """The forces on one robot on slopes of any angle, driving uphill in any direction."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot = with_ground_contacts(robot)
        self._points = [wheel.contact_point for wheel in robot.wheels]
        standing = standing_of(robot)
        self._stopped = held_joints(robot)
        if standing is not None:
            self._stopped |= standing.at_limit
        driven = stopping.driven_wheels(robot.wheels, robot.actuators)
        self._motors = float_sum(motor.max_torque / wheel.radius for wheel, motor in driven)

    def loads(self, angle: float, uphill: Direction = FORWARDS) -> list[float]:
        """Return the wheel loads in N on a slope of ``angle`` rad."""
        body = self._robot.inertial
        x, y, z = body.com
        slope = -uphill[0] * math.tan(angle), -uphill[1] * math.tan(angle)
        shifted = replace(body, com=(x + z * slope[0], y + z * slope[1], z))
        pivots = free_pivots(tree_of(self._robot), self._robot.wheels, self._stopped, slope)
        return [load * math.cos(angle) for load in static_loads(self._points, shifted, pivots)]

    def forces(self, angle: float, uphill: Direction = FORWARDS) -> SlopeForces:
        """Return the forces on the robot on a slope of ``angle`` rad, below a right angle."""
        loads = self.loads(angle, uphill)
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


# -- how a robot stands and rolls while its motors have no power --------------------------------
#
# A motor without power applies no torque. What is left of its drive is the back-driving torque B
# (the friction of motor and gear, see ``Actuator``) and the holding torque H of a closed brake.
# With the Coulomb friction C of the axle, the radius r, the load N, the coefficient c of rolling
# resistance and the coefficient mu of friction, a wheel resists the motion of the robot with the
# force
#
#     F = min(c N + (B + C + H) / r, mu N).
#
# The wheels hold a robot of the weight W on a slope of the angle a if the sum of F is at least W
# sin(a). The wheel loads depend on the slope (``slope``). The robot faces straight uphill or
# downhill with all steering angles at 0, and its steering joints and casters do not turn. The time
# in which a brake closes is not part of the statics: the robot rolls g sin(a) t^2 / 2 at most in
# it.
#
# A robot on level ground rolls out with the deceleration sum(F) / m. A single wheel that carries
# its share N / g of the mass rolls out with F g / N. The inertia of motors and wheels, which
# lengthens the way by some percent, is left out.


@dataclass(frozen=True, slots=True)
class StandingSlopes:
    """The steepest slopes in rad on which a robot stands without power, facing up or down.

    - ``motors_off``: with every brake held open, by the friction of motors, gears and tyres alone.
    - ``braked``: with the brakes closed, or ``None`` for a robot without brakes on its drives.
    """

    motors_off: si.Radians
    braked: si.Radians | None

    @property
    def without_power(self) -> float:
        """Steepest slope in rad on which the robot stands if its power is cut."""
        return self.motors_off if self.braked is None else self.braked


@once_per_model
def standing_slopes(robot: Robot) -> StandingSlopes | None:
    """Return the steepest slopes on which a robot stands without power.

    Returns ``None`` for a robot that does not stand on level ground.
    """
    if not support_of(robot).stands:
        return None
    drives = drives_of(robot)
    has_brake = any(motor is not None and motor.brake is not None for _, _, motor in drives)
    return StandingSlopes(
        _steepest(robot, drives, braked=False),
        _steepest(robot, drives, braked=True) if has_brake else None,
    )


@once_per_model
def holds_without_torque(robot: Robot) -> bool:
    """Return whether a standing robot stays at rest on its design slope if all motors lose torque.

    Brakes are closed then. Returns ``False`` for a robot whose file states no design slope: nothing
    is known of the ground on which it stands.
    """
    slopes = standing_slopes(robot)
    if slopes is None or robot.design_slope is None:
        return False
    return robot.design_slope <= slopes.without_power


def coasting_deceleration(
    wheel: Wheel, axle: Joint, motor: Actuator, *, braked: bool = False
) -> float:
    """Return the deceleration in m/s^2 of a wheel that rolls with its share of the mass.

    ``axle`` and ``motor`` turn the wheel. ``braked``: the brake of the motor is closed.
    """
    if wheel.load <= 0.0:
        return wheel.friction * GRAVITY
    return _resistance(wheel, axle, motor, wheel.load, braked) * GRAVITY / wheel.load


def roll_out(robot: Robot) -> stopping.Ramp:
    """Return the way on which all wheels roll out on level ground after all drives lost power.

    The wheel with the lowest deceleration counts, from the top speed of the motors. The time and
    the distance are infinite for a wheel without friction.
    """
    stops = [stopping.Ramp(0.0, 0.0, 0.0)]
    for wheel, motor in stopping.driven_wheels(robot.wheels, robot.actuators):
        axle, brake = robot.joint(wheel.spin_joint), motor.brake
        closing = 0.0 if brake is None else brake.closing_time
        deceleration = coasting_deceleration(wheel, axle, motor, braked=True)
        speed = motor.max_velocity * wheel.radius
        seconds = speed / deceleration if deceleration > 0.0 else math.inf
        stops.append(
            stopping.Ramp(speed, closing + seconds, speed * closing + 0.5 * speed * seconds)
        )
    return max(stops, key=lambda stop: stop.distance)


Drive = tuple[Wheel, Joint, Actuator | None]


def drives_of(robot: Robot) -> list[Drive]:
    joints = {joint.name: joint for joint in robot.joints}
    motors = {actuator.joint: actuator for actuator in robot.actuators}
    wheels = with_ground_contacts(robot).wheels
    return [(w, joints[w.spin_joint], motors.get(w.spin_joint)) for w in wheels]


def _resistance(
    wheel: Wheel, axle: Joint, motor: Actuator | None, load: float, braked: bool
) -> float:
    """Return the largest force in N with which a wheel without power resists motion."""
    torque = torque_without_power(axle, motor, braked=braked)
    force = wheel.rolling_resistance * load + torque / wheel.radius
    return min(force, wheel.friction * load)


def torque_without_power(axle: Joint, motor: Actuator | None, *, braked: bool) -> float:
    """Return the largest torque in N m with which a drive without power resists motion."""
    torque = axle.friction
    if motor is not None:
        torque += motor.back_driving_torque
        if braked and motor.brake is not None:
            torque += motor.brake.torque
    return torque


def _steepest(robot: Robot, drives: list[Drive], *, braked: bool) -> float:
    statics = SlopeStatics(robot)
    weight = robot.inertial.mass * GRAVITY

    def limit(uphill: Direction) -> float:
        def excess(angle: float) -> float:
            loads = statics.loads(angle, uphill)
            resistance = float_sum(
                _resistance(*drive, max(load, 0.0), braked)
                for drive, load in zip(drives, loads, strict=True)
            )
            return resistance - weight * math.sin(angle)

        tips = support_of(robot).tip_over_angle(math.pi if uphill == FORWARDS else 0.0)
        rolls = steepest_angle(excess)
        return tips if rolls is None else min(rolls, tips)

    return min(limit(FORWARDS), limit(DIRECTIONS["backwards"]))
