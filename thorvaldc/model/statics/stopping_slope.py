"""How a robot stops on a slope, driving straight downhill, forwards or backwards.

On a slope of the angle t, gravity accelerates a robot of the mass m by g sin(t).  To decelerate it
by a, the wheels must brake with the force m (a + g sin(t)).  The wheel i has the load N_i, the
radius r_i, the coefficient of friction mu_i, the coefficient c_i of rolling resistance, the axle
friction C_i, and the inertia J_i of wheel and rotor about its axle.  It brakes with at most

    F_i = min(c_i N_i + (T_i + C_i) / r_i - J_i a / r_i^2, mu_i N_i),

where T_i is the largest torque of its motor, 0 for a wheel without a motor.  A motor without power
has T_i = B_i + H_i, its back-driving torque and the torque of its closed brake (``unpowered``).

Deceleration and slope shift the load downhill alike: the force m (a + g sin(t)) acts at the height
of the centre of mass, as on a slope of the angle p with

    tan(p) = (a + g sin(t)) / (g cos(t)),  N_i = N_i(p) cos(t) / cos(p)   (see ``slope``).

The robot tips over if p exceeds its tip-over angle.

A kind of stop (``model.stopping``) with the speed v, the reaction time t_r and the ramp a keeps its
promise on the slope if the wheels can follow the ramp, or the lower deceleration v^2 / (2 (s - v
t_r)) that is enough for a stated stopping distance s.  During the reaction time the drives hold the
speed, which needs less force.  After the loss of a drive the others brake; a robot without another
drive then rolls as without power, which ``unpowered`` describes.

The robot is rigid, casters trail, all other joints are at position 0, the robot keeps its heading,
and sliding friction equals static friction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Robot, Wheel
from thorvaldc.model.statics.gravity import GRAVITY
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.slope import SlopeStatics, steepest_angle
from thorvaldc.model.statics.tip_over import support_of
from thorvaldc.model.stopping import (
    COMMAND_TIMEOUT,
    DRIVE_DEAD,
    DRIVER_DEAD,
    STOP_LOCK,
    coasting_nodes,
    driven_wheels,
    motor_nodes,
    quick_stop_ramp,
    reaction_times,
)

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

    return replace(robot, wheels=tuple(map(turned, robot.wheels)))


def _stops_of(robot: Robot) -> Iterator[SlopeStop]:
    """Yields the stops of a robot with all its settings, and with each drive that can die.

    Kinds of stops without a bound on level ground are left out.
    """
    driven = driven_wheels(robot.wheels, robot.actuators)
    motors = {motor.name for _, motor in driven}
    losses = []
    for _, node in motor_nodes(robot):
        dead = tuple(c.actuator for c in node.channels if c.actuator in motors)
        if dead and len(dead) < len(motors):
            losses.append(tuple(name for name in dead if name is not None))
    for settings in (robot.driver, *(p.driver for p in robot.parameter_sets)):
        speed, distance = settings.max_linear_velocity, robot.driver.stopping_distance
        for kind, reaction in reaction_times(robot, settings).items():
            if math.isinf(reaction) or (kind == DRIVER_DEAD and coasting_nodes(robot)):
                continue
            ramp = (
                settings.max_linear_deceleration
                if kind in (COMMAND_TIMEOUT, STOP_LOCK)
                else quick_stop_ramp(driven, settings).deceleration
            )
            way = math.inf if distance is None else distance - speed * reaction
            needed = ramp if distance is None or way <= 0.0 else min(ramp, speed**2 / (2.0 * way))
            for dead in losses if kind == DRIVE_DEAD else [()]:
                yield SlopeStop(kind, speed, reaction, ramp, needed, dead)


def _brakes_of(robot: Robot) -> list[_Brake]:
    tree = tree_of(robot)
    motors = {motor.joint: motor for _, motor in driven_wheels(robot.wheels, robot.actuators)}
    brakes = []
    for wheel in robot.wheels:
        axle, motor = robot.joint(wheel.spin_joint), motors.get(wheel.spin_joint)
        body = tree.inertial(tree.links_below(axle.child))
        xx, yy, zz, xy, xz, yz = body.inertia
        x, y, z = tree.pose[axle.child].rotate(axle.axis)
        inertia = xx * x * x + yy * y * y + zz * z * z
        inertia += 2.0 * (xy * x * y + xz * x * z + yz * y * z) + axle.armature
        powered = unpowered = axle.friction
        if motor is not None:
            powered += motor.max_torque
            unpowered += motor.back_driving_torque
            unpowered += motor.brake.torque if motor.brake is not None else 0.0
        brakes.append(
            _Brake(
                motor.name if motor is not None else "",
                wheel.radius,
                powered,
                unpowered,
                inertia / wheel.radius**2,
                wheel.rolling_resistance,
                wheel.friction,
            )
        )
    return brakes
