"""A robot on a slope: the forces on it, how it stops, and how it stands without power.

Forces on a robot that drives or stands straight up or down a slope. The robot is rigid and has all
joints at position 0. On a slope of the angle a, the weight W has the component W cos(a) into the
ground and W sin(a) downhill. The centre of mass at the height h then loads the wheels as if it were
above a point that is h tan(a) further downhill, which gives the wheel loads N_i (see
``static_loads``). Force that moves the robot uphill at a constant speed, with the coefficients of
rolling resistance c_i:

    F = W sin(a) + sum over wheels c_i N_i.

The motors push with at most the sum of torque over radius of the driven wheels. The grip of the
driven wheels with the coefficients of friction mu_i is sum mu_i N_i. The loads of a robot with
rockers leave out the moments that the driving forces have about the rockers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from thorvaldc.model import Actuator, Joint, Robot, Wheel, stopping
from thorvaldc.model import quantities as si
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.joint_tree import held_joints, tree_of
from thorvaldc.model.statics.standing import standing_of
from thorvaldc.model.statics.static_loads import Pivot, free_pivots, static_loads
from thorvaldc.model.statics.tip_over import support_of
from thorvaldc.model.sums import float_sum

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
        self._points = [wheel.contact_point for wheel in robot.wheels]
        standing = standing_of(robot)
        stopped = held_joints(robot) | (standing.at_limit if standing is not None else frozenset())
        self._pivots: list[Pivot] = free_pivots(tree_of(robot), robot.wheels, stopped)
        driven = stopping.driven_wheels(robot.wheels, robot.actuators)
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


# -- how a robot stops on a slope, driving straight downhill, forwards or backwards -------------
#
# On a slope of the angle t, gravity accelerates a robot of the mass m by g sin(t).  To decelerate
# it by a, the wheels must brake with the force m (a + g sin(t)).  The wheel i has the load N_i, the
# radius r_i, the coefficient of friction mu_i, the coefficient c_i of rolling resistance, the axle
# friction C_i, and the inertia J_i of wheel and rotor about its axle.  It brakes with at most
#
#     F_i = min(c_i N_i + (T_i + C_i) / r_i - J_i a / r_i^2, mu_i N_i),
#
# where T_i is the largest torque of its motor, 0 for a wheel without a motor.  A motor without
# power has T_i = B_i + H_i, its back-driving torque and the torque of its closed brake.
#
# Deceleration and slope shift the load downhill alike: the force m (a + g sin(t)) acts at the
# height of the centre of mass, as on a slope of the angle p with
#
#     tan(p) = (a + g sin(t)) / (g cos(t)),  N_i = N_i(p) cos(t) / cos(p)   (see ``slope``).
#
# The robot tips over if p exceeds its tip-over angle.
#
# A kind of stop (``model.stopping``) with the speed v, the reaction time t_r and the ramp a keeps
# its promise on the slope if the wheels can follow the ramp, or the lower deceleration v^2 / (2 (s
# - v t_r)) that is enough for a stated stopping distance s.  During the reaction time the drives
# hold the speed, which needs less force.  After the loss of a drive the others brake; a robot
# without another drive then rolls as without power, which ``unpowered`` describes.
#
# The robot is rigid, casters trail, all other joints are at position 0, the robot keeps its
# heading, and sliding friction equals static friction.

_BISECTIONS = 40


class SlopeStop(NamedTuple):
    """A kind of stop of a robot that drives straight downhill.

    - ``kind``: one of ``model.stopping.KINDS``.
    - ``speed``: speed in m/s at which the stop begins.
    - ``reaction``: time in s until the wheels decelerate.
    - ``ramp``: deceleration in m/s^2 that the base driver or the drives try to reach.
    - ``needed``: deceleration in m/s^2 that keeps the stopping distance, at most ``ramp``.
    - ``dead``: names of the motors without power.
    """

    kind: str
    speed: float
    reaction: float
    ramp: float
    needed: float
    dead: tuple[str, ...] = ()

    def distance(self, deceleration: float) -> float:
        """Return the distance in m of the stop, infinite without a ``deceleration`` (m/s^2)."""
        if deceleration <= 0.0:
            return math.inf
        return self.speed * self.reaction + self.speed**2 / (2.0 * deceleration)


class _Brake(NamedTuple):
    """A wheel with its largest braking torques in N m, and its inertia over r^2 in kg."""

    motor: str
    radius: float
    powered: float
    unpowered: float
    inertia: float
    rolling_resistance: float
    friction: float


class SlopeStops:
    """The stops of one robot on slopes of any angle."""

    def __init__(self, robot: Robot) -> None:
        robots = [_with_trailing_casters(robot, backwards) for backwards in (False, True)]
        self._slopes = [SlopeStatics(turned) for turned in robots]
        self._tangents = [
            math.tan(support_of(turned).tip_over_angle(downhill))
            for turned, downhill in zip(robots, (0.0, math.pi), strict=True)
        ]
        self._mass = robot.inertial.mass
        self._brakes = _brakes_of(robot)
        self.stops = tuple(_stops_of(robot))

    def reserve(
        self, angle: float, deceleration: float, dead: tuple[str, ...] = (), *, backwards: bool
    ) -> float:
        """Return the force in N that is left when the robot brakes on a slope of ``angle`` rad.

        The result is negative if the robot cannot brake with the ``deceleration`` in m/s^2, without
        the motors ``dead``, or tips over.
        """
        pull = deceleration / GRAVITY + math.sin(angle)
        shift = math.atan2(pull, math.cos(angle))
        scale = math.cos(angle) / math.cos(shift)
        # The loads of a robot that faces uphill backwards are those of one that drives downhill
        # forwards.
        loads = self._slopes[backwards].loads(shift, backwards=not backwards)
        force = float_sum(
            min(
                brake.rolling_resistance * load * scale
                + (brake.unpowered if brake.motor in dead else brake.powered) / brake.radius
                - brake.inertia * deceleration,
                brake.friction * load * scale,
            )
            for brake, load in zip(self._brakes, loads, strict=True)
        )
        weight = self._mass * GRAVITY
        tipping = weight * math.cos(angle) * self._tangents[backwards]
        return min(force, tipping) - weight * pull

    def deceleration(self, angle: float, stop: SlopeStop, *, backwards: bool) -> float:
        """Return the deceleration in m/s^2 of a stop on a slope of ``angle`` rad.

        It is at most the ramp of the stop, and 0 if the robot does not stop.
        """

        def possible(deceleration: float) -> bool:
            return self.reserve(angle, deceleration, stop.dead, backwards=backwards) >= 0.0

        if possible(stop.ramp):
            return stop.ramp
        low, high = 0.0, stop.ramp
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if possible(middle) else (low, middle)
        return low if possible(low) else 0.0

    def excess(self, angle: float, *, backwards: bool) -> float:
        """Return the force in N that is left when the robot brakes as its stops need.

        The result is negative if a stop on a slope of ``angle`` rad does not keep its promise.
        """
        demands = dict.fromkeys((stop.needed, stop.dead) for stop in self.stops)
        reserves = (self.reserve(angle, *demand, backwards=backwards) for demand in demands)
        return min(reserves, default=0.0)

    def steepest(self, *, backwards: bool) -> float:
        """Return the steepest slope in rad on which every stop keeps its promise."""
        angle = steepest_angle(lambda angle: self.excess(angle, backwards=backwards))
        return math.atan(self._tangents[backwards]) if angle is None else angle


@once_per_model
def steepest_stops(robot: Robot) -> tuple[float, float]:
    """Return the steepest slopes in rad on which a robot stops as it does on level ground.

    The two slopes are those of a robot that drives downhill forwards and backwards.  They are 0 for
    a robot that does not stand.
    """
    stops = SlopeStops(robot)
    return stops.steepest(backwards=False), stops.steepest(backwards=True)


def _with_trailing_casters(robot: Robot, backwards: bool) -> Robot:
    """Returns the robot with casters whose contact points trail behind their swivel axes."""

    def turned(wheel: Wheel) -> Wheel:
        if wheel.swivel_joint is None:
            return wheel
        ahead = (wheel.trail > 0.0) != backwards
        return replace(wheel, heading=math.pi if ahead else 0.0)

    if all(wheel.swivel_joint is None for wheel in robot.wheels):
        return robot  # the statics of a model are computed once
    return replace(robot, wheels=tuple(map(turned, robot.wheels)))


def _stops_of(robot: Robot) -> Iterator[SlopeStop]:
    """Yields the stops of a robot with all its settings, and with each drive that can die.

    Kinds of stops without a bound on level ground are left out.
    """
    driven = stopping.driven_wheels(robot.wheels, robot.actuators)
    motors = {motor.name for _, motor in driven}
    losses = []
    for _, node in stopping.motor_nodes(robot):
        dead = tuple(c.actuator for c in node.channels if c.actuator in motors)
        if dead and len(dead) < len(motors):
            losses.append(tuple(name for name in dead if name is not None))
    for settings in (robot.driver, *(p.driver for p in robot.parameter_sets)):
        speed, distance = settings.max_linear_velocity, robot.driver.stopping_distance
        for kind, reaction in stopping.reaction_times(robot, settings).items():
            if math.isinf(reaction) or (
                kind == stopping.DRIVER_DEAD and stopping.coasting_nodes(robot)
            ):
                continue
            ramp = (
                settings.max_linear_deceleration
                if kind in (stopping.COMMAND_TIMEOUT, stopping.STOP_LOCK)
                else stopping.quick_stop_ramp(driven, settings).deceleration
            )
            way = math.inf if distance is None else distance - speed * reaction
            needed = ramp if distance is None or way <= 0.0 else min(ramp, speed**2 / (2.0 * way))
            for dead in losses if kind == stopping.DRIVE_DEAD else [()]:
                yield SlopeStop(kind, speed, reaction, ramp, needed, dead)


def _brakes_of(robot: Robot) -> list[_Brake]:
    tree = tree_of(robot)
    brakes = []
    for wheel, axle, motor in _drives(robot):
        body = tree.inertial(tree.links_below(axle.child))
        xx, yy, zz, xy, xz, yz = body.inertia
        x, y, z = tree.pose[axle.child].rotate(axle.axis)
        inertia = xx * x * x + yy * y * y + zz * z * z
        inertia += 2.0 * (xy * x * y + xz * x * z + yz * y * z) + axle.armature
        brakes.append(
            _Brake(
                motor.name if motor is not None else "",
                wheel.radius,
                axle.friction + (motor.max_torque if motor is not None else 0.0),
                _torque_without_power(axle, motor, braked=True),
                inertia / wheel.radius**2,
                wheel.rolling_resistance,
                wheel.friction,
            )
        )
    return brakes


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
    drives = _drives(robot)
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


_Drive = tuple[Wheel, Joint, Actuator | None]


def _drives(robot: Robot) -> list[_Drive]:
    joints = {joint.name: joint for joint in robot.joints}
    motors = {actuator.joint: actuator for actuator in robot.actuators}
    return [(w, joints[w.spin_joint], motors.get(w.spin_joint)) for w in robot.wheels]


def _resistance(
    wheel: Wheel, axle: Joint, motor: Actuator | None, load: float, braked: bool
) -> float:
    """Return the largest force in N with which a wheel without power resists motion."""
    torque = _torque_without_power(axle, motor, braked=braked)
    force = wheel.rolling_resistance * load + torque / wheel.radius
    return min(force, wheel.friction * load)


def _torque_without_power(axle: Joint, motor: Actuator | None, *, braked: bool) -> float:
    """Return the largest torque in N m with which a drive without power resists motion."""
    torque = axle.friction
    if motor is not None:
        torque += motor.back_driving_torque
        if braked and motor.brake is not None:
            torque += motor.brake.torque
    return torque


def _steepest(robot: Robot, drives: list[_Drive], *, braked: bool) -> float:
    statics = SlopeStatics(robot)
    weight = robot.inertial.mass * GRAVITY

    def limit(backwards: bool) -> float:
        def excess(angle: float) -> float:
            loads = statics.loads(angle, backwards=backwards)
            resistance = float_sum(
                _resistance(*drive, max(load, 0.0), braked)
                for drive, load in zip(drives, loads, strict=True)
            )
            return resistance - weight * math.sin(angle)

        tips = support_of(robot).tip_over_angle(0.0 if backwards else math.pi)
        rolls = steepest_angle(excess)
        return tips if rolls is None else min(rolls, tips)

    return min(limit(False), limit(True))
