r"""Longest time and distance of each kind of stop of a robot on its CAN buses.

A stop has two parts.  During the reaction time t_r the robot keeps its speed v.  Then the wheels
decelerate, with the ramp of the base driver (deceleration a of the robot file) or with the quick
stop of the drives (deceleration a of the slowest motor):

    speed   v ____________
                          \              time      t = t_r + t_ramp
                           \             distance  s = v t_r + v^2 / (2 a)
            0 ______________\___
              |<-- t_r -->|<>| t_ramp

With T, the control cycle, and R, the worst-case response time of the frames on the bus
(``bus_timing``), the reaction times are:

| kind | begins with | reaction time |
| --- | --- | --- |
| ``command_timeout`` | last command | ``command_timeout`` + 2 T + R |
| ``stop_lock`` | the driver receives the stop | 2 T + R |
| ``detected_fault`` | the driver receives the frame | 2 T + R |
| ``driver_dead`` | last cycle of the driver | longest watchdog of a drive + T + R |
| ``drive_dead`` | last frame of the drive | time-out of its reports + late cycles + 2 T + R |

An event that occurs just after the driver has read its frames waits for the next cycle (T).  The
drives apply a command at most one cycle after it was sent (T).  The watchdog of a drive starts with
the last heartbeat of the master (object 0x1016), or with the last command (``command_watchdog``).
The driver does not judge silence in at most ``LATE_CYCLES`` late cycles.

Assumptions: the wheels do not slip, the ground is level, and the wheels follow the ramps.  A drive
without power does not brake; then the other wheels decelerate the robot.  A drive whose watchdog
only takes the torque away (``watchdog_coasts``) has no bound after the death of the driver.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from thorvaldc.model import Actuator, Bus, DriverSettings, Node, Robot, Wheel
from thorvaldc.model.bus import MASTER
from thorvaldc.model.sums import float_sum

COMMAND_TIMEOUT, STOP_LOCK = "command_timeout", "stop_lock"
DETECTED_FAULT, DRIVER_DEAD, DRIVE_DEAD = "detected_fault", "driver_dead", "drive_dead"
KINDS = (COMMAND_TIMEOUT, STOP_LOCK, DETECTED_FAULT, DRIVER_DEAD, DRIVE_DEAD)
"""Kinds of stops; the docstring of this module describes them."""

REPORT_TIMEOUT = 2.5
"""Time-out of a report in periods: two reports in a row are missing."""
HEARTBEAT_TIMEOUT = 3.0
"""Time-out of a heartbeat in periods, unless ``Node.heartbeat_timeout`` is shorter."""
LATE_CYCLES = 2
"""Largest number of late cycles in a row in which the driver does not check for silence."""


class StopBound(NamedTuple):
    """Longest time and distance in which a kind of stop ends.

    - ``kind``: one of ``KINDS``.
    - ``reaction``: longest time in s until the wheels decelerate.
    - ``time``: longest time in s until the robot stands.
    - ``distance``: longest distance in m of ``base_link`` until the robot stands.
    """

    kind: str
    reaction: float
    time: float
    distance: float


class Ramp(NamedTuple):
    """A deceleration to rest.

    - ``speed``: greatest speed of ``base_link`` in m/s.
    - ``time``: longest time in s until all wheels stand, also after a turn.
    - ``distance``: longest distance in m that ``base_link`` travels during the deceleration.
    """

    speed: float
    time: float
    distance: float

    @property
    def deceleration(self) -> float:
        """Mean deceleration in m/s^2 on the longest distance."""
        return _ratio(self.speed**2, 2.0 * self.distance)


DrivenWheels = Sequence[tuple[Wheel, Actuator]]
"""The driven wheels of a robot with their propulsion motors."""


def stop_bounds(robot: Robot) -> tuple[StopBound, ...]:
    """Returns the longest time and distance of each kind of stop, in the order of ``KINDS``.

    They are the longest ones of the robot's settings and of all its parameter sets.  The kinds
    ``driver_dead`` and ``drive_dead`` are missing for a robot without motor controllers on a bus.
    The time and the distance of ``driver_dead`` are infinite if a drive has no watchdog, or coasts
    after it.
    """
    choices = [robot.driver, *(p.driver for p in robot.parameter_sets)]
    driven = driven_wheels(robot.wheels, robot.actuators)
    bounds: dict[str, StopBound] = {}
    for choice in choices:
        for kind, reaction in reaction_times(robot, choice).items():
            ramp = driver_ramp if kind in (COMMAND_TIMEOUT, STOP_LOCK) else quick_stop_ramp
            stop = ramp(driven, choice)
            distance = stop.speed * reaction + stop.distance if stop.speed > 0.0 else 0.0
            bound = StopBound(kind, reaction, reaction + stop.time, distance)
            if kind == DRIVER_DEAD and coasting_nodes(robot):
                bound = StopBound(kind, reaction, math.inf, math.inf)
            other = bounds.get(kind, bound)
            bounds[kind] = StopBound(
                kind,
                max(bound.reaction, other.reaction),
                max(bound.time, other.time),
                max(bound.distance, other.distance),
            )
    return tuple(bounds.values())


def shortest_watchdog(robot: Robot) -> float | None:
    """Returns the shortest watchdog time in s of all motor controllers of the robot.

    Returns ``None`` if no motor controller has a watchdog.
    """
    times = [watchdog_time(node) for _, node in motor_nodes(robot)]
    return min((time for time in times if time is not None), default=None)


def watchdog_time(node: Node) -> float | None:
    """Returns the longest time in s for which a drive runs without its master.

    Returns ``None`` if the drive does not supervise its master.
    """
    times = (node.heartbeat_consumer_time, node.command_watchdog)
    return min((time for time in times if time is not None), default=None)


def coasting_nodes(robot: Robot) -> list[Node]:
    """Returns the motor controllers whose motors coast if the base driver dies."""
    return [node for _, node in motor_nodes(robot) if node.watchdog_coasts]


def driven_wheels(
    wheels: Sequence[Wheel], actuators: Sequence[Actuator]
) -> list[tuple[Wheel, Actuator]]:
    """Returns the driven wheels with their propulsion motors."""
    by_joint = {actuator.joint: actuator for actuator in actuators}
    return [(w, by_joint[w.spin_joint]) for w in wheels if w.driven and w.spin_joint in by_joint]


def motor_nodes(robot: Robot) -> Iterator[tuple[Bus, Node]]:
    """Yields the motor controllers of the robot, each with its bus."""
    for bus in robot.buses:
        for node in bus.nodes:
            if any(channel.actuator is not None for channel in node.channels):
                yield bus, node


def reaction_times(robot: Robot, settings: DriverSettings) -> dict[str, float]:
    """Returns the reaction time in s of each kind of stop, by kind."""
    cycle = 1.0 / settings.rate
    nodes = list(motor_nodes(robot))
    response = max((bus_response_time(bus) for bus, _ in nodes), default=0.0)
    command = 2.0 * cycle + response
    times = {
        COMMAND_TIMEOUT: settings.command_timeout + command,
        STOP_LOCK: command,
        DETECTED_FAULT: command,
    }
    if nodes:
        watchdogs = [watchdog_time(node) for _, node in nodes]
        longest = max(math.inf if time is None else time for time in watchdogs)
        times[DRIVER_DEAD] = longest + cycle + response
        silence = max(_silence_timeout(bus, node) for bus, node in nodes)
        times[DRIVE_DEAD] = silence + LATE_CYCLES * cycle + command
    return times


def driver_ramp(driven: DrivenWheels, settings: DriverSettings) -> Ramp:
    """Returns the deceleration by the ramp of the base driver.

    The ramp changes the linear velocity v and the angular velocity w in the same share, so that its
    duration is max(v / a, w / alpha), and its distance is v times half of the duration.  A wheel at
    the distance L from the centre with the top speed V allows v^2 + (w L)^2 <= V^2.  The distance
    is greatest at the greatest v, at v = V / sqrt(2), or where w reaches its own limit.
    """
    if not driven:
        return Ramp(0.0, 0.0, 0.0)
    a, alpha = settings.max_linear_deceleration, settings.max_angular_deceleration
    top_speed, top_rate = settings.max_linear_velocity, settings.max_angular_velocity
    wheel_speed = min(actuator.max_velocity * wheel.radius for wheel, actuator in driven)
    lever = max(math.hypot(wheel.x, wheel.y) for wheel, _ in driven)

    def duration(speed: float) -> float:
        turning = math.sqrt(max(wheel_speed**2 - speed**2, 0.0))
        rate = min(top_rate, turning / lever if lever > 0.0 else math.inf)
        return max(_ratio(speed, a), _ratio(rate, alpha))

    at_top_rate = math.sqrt(max(wheel_speed**2 - (top_rate * lever) ** 2, 0.0))
    speeds = [min(v, top_speed) for v in (top_speed, wheel_speed / math.sqrt(2.0), at_top_rate)]
    distance = max(0.5 * v * duration(v) if v > 0.0 else 0.0 for v in speeds)
    return Ramp(top_speed, max(_ratio(top_speed, a), _ratio(top_rate, alpha)), distance)


def quick_stop_ramp(driven: DrivenWheels, settings: DriverSettings) -> Ramp:
    """Returns the deceleration by the quick stop of the drives.

    The wheel with the lowest deceleration determines the deceleration of the robot.  In a turn a
    wheel can be faster than ``base_link``, but not faster than its motor.
    """
    if not driven:
        return Ramp(0.0, 0.0, 0.0)
    speed = settings.max_linear_velocity
    deceleration = min(actuator.max_acceleration * wheel.radius for wheel, actuator in driven)
    duration = max(_ratio(a.max_velocity, a.max_acceleration) for _, a in driven)
    distance = 0.5 * speed * _ratio(speed, deceleration) if speed > 0.0 else 0.0
    return Ramp(speed, max(duration, _ratio(speed, deceleration)), distance)


def reachable_speed(distance: float, reaction: float, deceleration: float) -> float:
    """Returns the greatest speed in m/s from which a robot stops within ``distance`` m.

    The speed v is the solution of ``distance = v reaction + v^2 / (2 deceleration)``.
    """
    if math.isinf(reaction) or distance <= 0.0:
        return 0.0
    lost = deceleration * reaction
    return math.sqrt(lost * lost + 2.0 * deceleration * distance) - lost


def bus_response_time(bus: Bus) -> float:
    """Returns the worst-case response time in s of the commands, SYNC and periodic reports."""
    kinds = ("pdo", "sync", "heartbeat")
    times = [f.response_time for f in bus.frames if f.kind in kinds and f.period is not None]
    return max((bus.sync_period if time is None else time for time in times), default=0.0)


# -- inside ------------------------------------------------------------------------------------


def _silence_timeout(bus: Bus, node: Node) -> float:
    """Returns the time in s after which the driver notices that a motor controller is silent."""
    frames = [f for f in bus.frames if f.producer == node.name and f.period is not None]
    reports = [REPORT_TIMEOUT * f.period for f in frames if f.kind == "pdo" and f.period]
    if reports:
        return min(reports)
    heartbeats = [
        HEARTBEAT_TIMEOUT * f.period for f in frames if f.kind == "heartbeat" and f.period
    ]
    stated = [node.heartbeat_timeout] if node.heartbeat_timeout is not None else []
    return min([*heartbeats, *stated], default=math.inf)


def _ratio(a: float, b: float) -> float:
    return a / b if b > 0.0 else (0.0 if a == 0.0 else math.inf)


# -- yaw after the loss of one bus ---------------------------------------------------------------
#
# A robot that drives straight ahead turns if it loses one of its buses.  The wheels of the lost bus
# run on until the watchdogs of their drives act, after the time W.  If the other wheels stop
# earlier, the paths of the wheels differ by D.  With the wheels at the lateral
# positions y_i and their mean y_m, the yaw that fits the paths best is
#
#     psi = D sum_lost(y_i - y_m) / sum_all(y_i - y_m)^2        D / track with one bus for each side
#
# At the speed v:
#
# | kind | the driver | greatest D |
# | --- | --- | --- |
# | ``bus_lost`` | knows that the bus is lost, and stops all wheels together | v e |
# | ``bus_silent`` | only receives nothing, and stops the other wheels at once | v (W + e) |
#
# e is the time by which the begin of the watchdog is unknown: a heartbeat period of the master, two
# control cycles, and the response time of the bus.  Wheels that resist a yaw with their lateral
# friction make it smaller.  ``runtime/can_base/bus_connection.py`` explains the reaction.

BUS_LOST, BUS_SILENT = "bus_lost", "bus_silent"
NEGLIGIBLE = 1e-6
"""Lever (m) of lost wheels on both sides, which differs from zero by rounding only."""


class SwerveBound(NamedTuple):
    """Largest yaw of a stop after the loss of one bus.

    - ``kind``: ``bus_lost`` or ``bus_silent``; the docstring of this module describes them.
    - ``bus``: name of the bus whose loss causes the yaw.
    - ``yaw``: largest yaw in rad; infinite if a drive of the bus has no watchdog.
    """

    kind: str
    bus: str
    yaw: float


def swerve_bounds(robot: Robot) -> tuple[SwerveBound, ...]:
    """Returns the bounds for each kind, at the bus whose loss causes the largest yaw.

    Returns an empty tuple if all driven wheels are on one bus.
    """
    driven = driven_wheels(robot.wheels, robot.actuators)
    on_buses = [bus for bus in robot.buses if _wheels_on(bus, driven)]
    if len(on_buses) < 2:
        return ()
    bounds = [bound for bus in on_buses for bound in _bounds(robot, bus)]
    return tuple(
        max((bound for bound in bounds if bound.kind == kind), key=lambda bound: bound.yaw)
        for kind in (BUS_LOST, BUS_SILENT)
    )


def yaw_per_metre(robot: Robot, buses: Sequence[Bus]) -> float:
    """Returns the yaw in rad for each metre that the wheels on ``buses`` travel further."""
    driven = driven_wheels(robot.wheels, robot.actuators)
    mean = float_sum(wheel.y for wheel, _ in driven) / max(len(driven), 1)
    squares = float_sum((wheel.y - mean) ** 2 for wheel, _ in driven)
    lever = abs(float_sum(w.y - mean for bus in buses for w in _wheels_on(bus, driven)))
    return lever / squares if lever > NEGLIGIBLE else 0.0


def _wheels_on(bus: Bus, driven: DrivenWheels) -> list[Wheel]:
    motors = {channel.actuator for node in bus.nodes for channel in node.channels}
    return [wheel for wheel, actuator in driven if actuator.name in motors]


def _bounds(robot: Robot, bus: Bus) -> tuple[SwerveBound, ...]:
    nodes = [n for n in bus.nodes if any(c.actuator is not None for c in n.channels)]
    times = [watchdog_time(node) for node in nodes]
    watchdog = max(math.inf if time is None else time for time in times)
    beats = [f.period or 0.0 for f in bus.frames if f.kind == "heartbeat" and f.producer == MASTER]
    consumes = any(node.heartbeat_consumer_time is not None for node in nodes)
    unknown = bus_response_time(bus) + 2.0 / robot.driver.rate
    unknown += max(beats, default=0.0) if consumes else 0.0
    speed = max(
        d.max_linear_velocity for d in (robot.driver, *(p.driver for p in robot.parameter_sets))
    )
    metres = speed * yaw_per_metre(robot, [bus])
    if math.isinf(watchdog):
        return tuple(SwerveBound(kind, bus.name, math.inf) for kind in (BUS_LOST, BUS_SILENT))
    return (
        SwerveBound(BUS_LOST, bus.name, metres * unknown),
        SwerveBound(BUS_SILENT, bus.name, metres * (watchdog + unknown)),
    )
