"""How a robot stops on a slope, driving straight downhill.

On a slope of the angle t, gravity accelerates a robot of the mass m by g sin(t).  To decelerate
it by a, the wheels must brake with the force m (a + g sin(t)).  The wheel i has the load N_i, the
radius r_i, the coefficient of friction mu_i, the coefficient c_i of rolling resistance, the axle
friction C_i, and the inertia J_i of wheel and rotor about its axle.  It brakes with at most

    F_i = min(c_i N_i + (T_i + C_i) / r_i - J_i a / r_i^2, mu_i N_i),

where T_i is the largest torque of its motor, 0 for a wheel without a motor.  A motor without
power has T_i = B_i + H_i, its back-driving torque and the torque of its closed brake.

Deceleration and slope shift the load downhill alike: the force m (a + g sin(t)) acts at the
height h of the centre of mass.  The wheels lose their spin too: with the inertia I_i of a wheel
without its rotor, which turns in its own bearings, their moment is that of a deceleration that is
larger by k = 1 + sum(I_i / r_i) / (m h).  The loads are those on a slope of the angle p with

    tan(p) = (k a + g sin(t)) / (g cos(t)),  N_i = N_i(p) cos(t) / cos(p)   (see ``loads``).

The robot tips over if p exceeds its tip-over angle q, from the deceleration

    a = g (tan(q) cos(t) - sin(t)) / k

on.  Springs lean it downhill by the angle e, which makes tan(q) smaller by e (``_lean``).  The
wheels do not know of it: they brake with their ramp, also where less would do, as far as torque
and grip allow.  At the beginning of a ramp the deceleration is larger: a speed servo overshoots
(``_OVERSHOOT``), and a robot on springs swings (``_SWING``), also when it stops to accelerate.

A kind of stop (``model.stopping``) with the speed v, the reaction time t_r and the ramp a keeps
its promise on the slope if the wheels can follow the ramp, or the lower deceleration v^2 / (2 (s
- v t_r)) that is enough for a stated stopping distance s.  During the reaction time the drives
hold the speed, which needs less force.  After the loss of a drive the others brake; a robot
without another drive then rolls as without power, see ``slope``.

The robot is rigid, casters trail, steered wheels point along the motion, all other joints are at
position 0, the robot keeps its heading, and sliding friction equals static friction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.model import Robot, Wheel, stopping
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.ground_contacts import with_ground_contacts
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.slope import (
    DIRECTIONS,
    FORWARDS,
    Direction,
    SlopeStatics,
    directions_of,
    drives_of,
    steepest_angle,
    torque_without_power,
)
from thorvaldc.model.statics.static_loads import spring_rates
from thorvaldc.model.statics.tip_over import Support, support_of
from thorvaldc.model.sums import float_sum

_BISECTIONS = 40
_OVERSHOOT = 1.0 + math.exp(-2.0)
"""Largest deceleration of a speed servo with critical damping, as a share of a new ramp."""
_SWING = 2.0
"""Largest lean of a robot on springs without dampers, as a share of its lean after a step."""
_RESERVE = 0.94
"""Share of braking force and balance on which a stop relies.  Wheels also push sideways, and tyres
yield."""
_HEADING_ERROR = math.radians(2.0)
"""Error of the heading of a robot that drives straight downhill."""
_STIFFEST = 1e8  # N/m, of a wheel without springs
_SPRUNG = 1e-3  # rad, smallest lean that counts as one on springs


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
    """A wheel with its largest braking torques in N m, its inertia with the rotor over r^2 in kg,
    and its inertia without the rotor over r in kg m."""

    motor: str
    radius: float
    powered: float
    unpowered: float
    inertia: float
    spin: float
    rolling_resistance: float
    friction: float


class SlopeStops:
    """The stops of one robot that drives straight downhill, on slopes of any angle."""

    def __init__(self, robot: Robot, downhill: Direction = FORWARDS) -> None:
        x, y = downhill
        heading = math.atan2(y, x)
        turned = _turned(robot, heading)
        support = support_of(turned)
        self._statics, self._uphill = SlopeStatics(turned), (-x, -y)
        self._lean = _lean(turned, support, heading)
        tip_over = min(support.tip_over_angle(heading + k * _HEADING_ERROR) for k in (-1, 0, 1))
        self._tangent = max(_RESERVE * (math.tan(tip_over) - self._lean), 0.0)
        self._acceleration = robot.driver.max_linear_acceleration
        self._mass = robot.inertial.mass
        self._brakes = _brakes_of(robot)
        spin = float_sum(brake.spin for brake in self._brakes)
        self._lever = 1.0 + spin / (self._mass * max(support.com[2], 1e-9))
        self.stops = tuple(_stops_of(robot))

    def reserve(
        self, angle: float, deceleration: float, dead: tuple[str, ...] = (), share: float = 1.0
    ) -> float:
        """Return the force in N that is left when the robot brakes on a slope of ``angle`` rad.

        The result is negative if a ``share`` of the forces of all wheels, without the motors
        ``dead``, cannot brake the robot with the ``deceleration`` in m/s^2.
        """
        pull = deceleration / GRAVITY + math.sin(angle)
        moment = self._lever * deceleration / GRAVITY + math.sin(angle)
        shift = math.atan2(moment, math.cos(angle))
        scale = math.cos(angle) / math.cos(shift)
        loads = self._statics.loads(shift, self._uphill)
        force = float_sum(
            min(
                brake.rolling_resistance * load * scale
                + (brake.unpowered if brake.motor in dead else brake.powered) / brake.radius
                - brake.inertia * deceleration,
                brake.friction * load * scale,
            )
            for brake, load in zip(self._brakes, loads, strict=True)
        )
        return share * force - self._mass * GRAVITY * pull

    def balance(self, angle: float, stop: SlopeStop) -> float:
        """Return a force in N that is negative if the robot tips over in a stop on a slope of
        ``angle`` rad: its ramp is too steep, and the wheels can brake so."""
        peak = _OVERSHOOT * stop.ramp
        if self._lean > _SPRUNG:
            peak = max(_SWING * stop.ramp, self._acceleration)
        pull = self._tangent * math.cos(angle) - math.sin(angle)
        tipping = GRAVITY * pull / self._lever
        excess = self._mass * (tipping - peak)
        if excess >= 0.0:
            return excess
        return max(excess, -self.reserve(angle, min(tipping, stop.ramp), stop.dead))

    def deceleration(self, angle: float, stop: SlopeStop) -> float:
        """Return the deceleration in m/s^2 of a stop on a slope of ``angle`` rad.

        It is at most the ramp of the stop, and 0 if the robot does not stop or tips over.
        """

        def possible(deceleration: float) -> bool:
            return self.reserve(angle, deceleration, stop.dead) >= 0.0

        if self.balance(angle, stop) < 0.0:
            return 0.0
        if possible(stop.ramp):
            return stop.ramp
        low, high = 0.0, stop.ramp
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if possible(middle) else (low, middle)
        return low if possible(low) else 0.0

    def excess(self, angle: float) -> float:
        """Return the force in N that is left when the robot brakes as its stops need.

        The result is negative if a stop on a slope of ``angle`` rad does not keep its promise, or
        wheels slide while it begins.
        """
        stops = {(stop.ramp, stop.needed, stop.dead): stop for stop in self.stops}.values()
        return min(
            (
                min(
                    self.reserve(angle, _OVERSHOOT * stop.needed, stop.dead, _RESERVE),
                    self.balance(angle, stop),
                )
                for stop in stops
            ),
            default=0.0,
        )

    def steepest(self) -> float:
        """Return the steepest slope in rad on which every stop keeps its promise."""
        angle = steepest_angle(self.excess)
        return math.atan(self._tangent) if angle is None else angle


@once_per_model
def steepest_stops(robot: Robot) -> dict[str, float]:
    """Return the steepest slopes in rad on which a robot stops as it does on level ground.

    The keys are the directions in which the robot can drive downhill.  The slopes are 0 for a robot
    that does not stand.
    """
    return {name: SlopeStops(robot, DIRECTIONS[name]).steepest() for name in directions_of(robot)}


def _lean(robot: Robot, support: Support, heading: float) -> float:
    """Returns the angle in rad by which a robot leans on its springs when it tips over downhill.

    It is W d / K, with the weight W, the distance d of the edge on which the weight then is, and
    the stiffness K of the springs against rotation.
    """
    x, y = math.cos(heading), math.sin(heading)
    rates = [min(rate, _STIFFEST) for rate in spring_rates(tree_of(robot), robot.wheels)]
    places = [wheel.contact_point[0] * x + wheel.contact_point[1] * y for wheel in robot.wheels]
    middle = float_sum(k * s for k, s in zip(rates, places, strict=True)) / float_sum(rates)
    stiffness = float_sum(k * (s - middle) ** 2 for k, s in zip(rates, places, strict=True))
    distance = support.com[2] * math.tan(support.tip_over_angle(heading))
    return robot.inertial.mass * GRAVITY * distance / stiffness if stiffness > 0.0 else 0.0


def _turned(robot: Robot, heading: float) -> Robot:
    """Returns the robot with wheels turned for a motion in the direction ``heading`` (rad).

    The contact points of casters trail behind their swivel axes.
    """

    robot = with_ground_contacts(robot)

    def turned(wheel: Wheel) -> Wheel:
        if wheel.swivel_joint is not None:
            return replace(wheel, heading=heading + (math.pi if wheel.trail > 0.0 else 0.0))
        if wheel.steered and abs(math.cos(heading)) < 0.5:
            return replace(wheel, heading=heading)
        return wheel

    wheels = tuple(map(turned, robot.wheels))
    if wheels == robot.wheels:
        return robot  # the statics of a model are computed once
    return replace(robot, wheels=wheels)


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
    for wheel, axle, motor in drives_of(robot):
        body = tree.inertial(tree.links_below(axle.child))
        xx, yy, zz, xy, xz, yz = body.inertia
        x, y, z = tree.pose[axle.child].rotate(axle.axis)
        inertia = xx * x * x + yy * y * y + zz * z * z
        inertia += 2.0 * (xy * x * y + xz * x * z + yz * y * z)
        brakes.append(
            _Brake(
                motor.name if motor is not None else "",
                wheel.radius,
                axle.friction + (motor.max_torque if motor is not None else 0.0),
                torque_without_power(axle, motor, braked=True),
                (inertia + axle.armature) / wheel.radius**2,
                inertia / wheel.radius,
                wheel.rolling_resistance,
                wheel.friction,
            )
        )
    return brakes
