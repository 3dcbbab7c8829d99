"""Derives watchdog times from the stated stopping distance, and checks the resulting distances.

A robot with the top speed v and the deceleration a stops within the distance s if the reaction time
is at most t = (s - v^2 / (2 a)) / v.  From the reaction time follow, with the control cycle T:

    command_timeout                      t - 3 T    (ramp of the base driver)
    heartbeat consumer time of a drive   t - 2 T    (object 0x1016; quick stop of the drive)
    heartbeat period of the master       (heartbeat consumer time - 2 T) / 2

The terms with T contain the worst-case response time R of the bus, for which R <= T is assumed.
The check of the finished robot uses the response time that was computed for its buses
(``model.stopping``).  Derived times are never longer than the times without a stopping distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from thorvaldc.compiler.bus.device_sections import MASTER_HEARTBEAT_PERIOD
from thorvaldc.compiler.robot_settings.robot_sections import DesignRequirements
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Proposal, Report, plain
from thorvaldc.model import DriverSettings, ParameterSet, Robot, stopping
from thorvaldc.model.statics.slope import DIRECTIONS, directions_of
from thorvaldc.model.statics.slope_stops import SlopeStops, steepest_stops

SHORTEST_TIMEOUT = 0.1
"""Shortest derived command time-out (s), so that sources with 20 Hz may lose a command."""
SHORTEST_WATCHDOG_CYCLES = 4
"""Shortest derived heartbeat consumer time in control cycles: two heartbeats and their delays."""
_ROUNDING = 1e-9

_CAUSES = {
    stopping.COMMAND_TIMEOUT: "when commands stop",
    stopping.STOP_LOCK: "after a stop command",
    stopping.DETECTED_FAULT: "after a detected fault",
    stopping.DRIVER_DEAD: "when the base driver dies",
    stopping.DRIVE_DEAD: "when a drive dies",
}


def with_command_timeout(
    driver: DriverSettings,
    sets: Sequence[ParameterSet],
    stated: Node | None,
    driven: stopping.DrivenWheels,
) -> tuple[DriverSettings, tuple[ParameterSet, ...]]:
    """Returns the settings with a command time-out that meets the stopping distance.

    ``stated``: command time-out in the robot file, which is not changed.
    """
    distance = driver.stopping_distance
    if distance is None or stated is not None:
        return driver, tuple(sets)
    timeout = driver.command_timeout
    for settings in (driver, *(parameter_set.driver for parameter_set in sets)):
        allowed = _reaction(distance, stopping.driver_ramp(driven, settings))
        timeout = min(timeout, _whole_milliseconds(allowed - 3.0 / driver.rate))
    timeout = max(timeout, SHORTEST_TIMEOUT, 3.0 / driver.rate)
    timeout = min(timeout, driver.command_timeout)
    return replace(driver, command_timeout=timeout), tuple(
        replace(s, driver=replace(s.driver, command_timeout=timeout)) for s in sets
    )


def longest_watchdog(
    driver: DriverSettings, sets: Sequence[ParameterSet], driven: stopping.DrivenWheels
) -> float:
    """Returns the longest heartbeat consumer time (s) of a drive, infinite without a stopping
    distance."""
    if driver.stopping_distance is None:
        return math.inf
    cycle = 1.0 / driver.rate
    ramps = [stopping.quick_stop_ramp(driven, s) for s in (driver, *(p.driver for p in sets))]
    allowed = min(_reaction(driver.stopping_distance, ramp) for ramp in ramps)
    return max(_whole_milliseconds(allowed - 2.0 * cycle), SHORTEST_WATCHDOG_CYCLES * cycle)


def master_heartbeat_period(consumer_time: float, cycle: float) -> float:
    """Returns the heartbeat period (s) of the master for the shortest consumer time of a drive.

    ``cycle``: control cycle (s).  The master sends a heartbeat only in a control cycle, so that the
    period is a whole number of cycles.
    """
    if math.isinf(consumer_time):
        return MASTER_HEARTBEAT_PERIOD
    cycles = math.floor((consumer_time - 2.0 * cycle) / (2.0 * cycle) + _ROUNDING)
    return min(MASTER_HEARTBEAT_PERIOD, max(cycles, 1) * cycle)


def check_stopping_distance(robot: Robot, driver: Node, report: Report) -> None:
    """Reports an error if a kind of stop is longer than the stated stopping distance.

    ``driver``: mapping ``driver`` of the robot file.
    """
    distance, node = robot.driver.stopping_distance, driver.get("stopping_distance")
    if distance is None or node is None:
        return
    bounds = stopping.stop_bounds(robot)
    worst = max(bounds, key=lambda bound: bound.distance)
    if worst.distance <= distance + _ROUNDING:
        return
    reached = (
        "any distance" if math.isinf(worst.distance) else f"up to {plain(worst.distance, 3)} m"
    )
    fixed = _fixed_watchdog(robot) if worst.kind == stopping.DRIVER_DEAD else ""
    speed = min(_speed(robot, bound, distance) for bound in bounds)
    report.add(
        "stopping-distance",
        f"the robot needs {reached} to stop {_CAUSES[worst.kind]}{fixed}; "
        f"the stopping distance is {plain(distance)} m",
        node.span,
        hint=_slower(speed, driver),
    )


def check_stops_on_slope(
    robot: Robot, design: DesignRequirements, driver: Node | None, report: Report
) -> None:
    """Reports an error if a stop straight down the design slope is longer than it may be.

    ``driver``: mapping ``driver`` of the robot file.  Without a stated stopping distance, the robot
    must only stop while all its drives have power.
    """
    slope, distance = design.slope, robot.driver.stopping_distance
    if slope is None or not any(wheel.driven for wheel in robot.wheels):
        return
    statics = {name: SlopeStops(robot, DIRECTIONS[name]) for name in directions_of(robot)}
    if min(stops.excess(slope) for stops in statics.values()) >= 0.0:
        return
    speed, longest, kind, direction, tips = math.inf, 0.0, "", "", False
    for name, stops in statics.items():
        for stop in stops.stops:
            deceleration = stops.deceleration(slope, stop)
            if distance is not None:
                speed = min(speed, stopping.reachable_speed(distance, stop.reaction, deceleration))
            elif stop.dead:
                continue
            if stop.distance(deceleration) > longest:
                longest, kind, direction = stop.distance(deceleration), stop.kind, name
                tips = stops.balance(slope, stop) < 0.0
    ends = math.isfinite(longest)
    if ends if distance is None else longest <= distance + _ROUNDING:
        return
    limit = steepest_stops(robot)[direction]
    where, node = design.slope_span or robot.span, driver and driver.get("stopping_distance")
    motion = f"driving {direction} down {math.degrees(slope):.1f} deg, the robot"
    if not ends or distance is None or node is None or driver is None:
        problem = f"does not stop {_CAUSES[kind]}: its wheels cannot brake it"
        remedy = "brake more wheels, or move weight onto those with motors"
        if tips:
            problem = f"tips over {_CAUSES[kind]}"
            remedy = "lower the centre of mass, or brake more gently"
        report.add(
            "stopping-slope",
            f"{motion} {problem}",
            where,
            hint=f"{remedy}; up to {math.degrees(limit):.1f} deg it stops as on level ground",
        )
        return
    report.add(
        "stopping-slope",
        f"{motion} needs up to {plain(longest, 3)} m to stop {_CAUSES[kind]}; "
        f"the stopping distance is {plain(distance)} m",
        node.span,
        labels=[Label(where, f"it is kept up to {math.degrees(limit):.1f} deg")],
        hint=_slower(speed, driver),
    )


def _slower(speed: float, driver: Node) -> str:
    """Returns a hint with the speed (m/s) that keeps the stopping distance."""
    speed = math.floor(100.0 * speed) / 100.0
    remedy = (
        f"`max_linear_velocity: {speed:g} m/s`"
        if speed > 0.0
        else "drives that brake by themselves"
    )
    hint = f"use {remedy}, or a stopping distance that all stops can keep"
    stated_speed = driver.get("max_linear_velocity")
    if speed > 0.0 and stated_speed is not None:
        return Proposal(hint, f"{speed:g} m/s", span=stated_speed.span)
    return hint


def _fixed_watchdog(robot: Robot) -> str:
    coasting = stopping.coasting_nodes(robot)
    if coasting:
        return f" (the watchdog of `{coasting[0].module}` lets its motor coast)"
    times = [
        n.command_watchdog for _, n in stopping.motor_nodes(robot) if n.command_watchdog is not None
    ]
    if not times:
        return ""
    return f" (the watchdog of its drives is {max(times):g} s and cannot be changed)"


def _speed(robot: Robot, bound: stopping.StopBound, distance: float) -> float:
    """Returns the speed (m/s) from which a kind of stop keeps the stopping distance."""
    if math.isinf(bound.distance):
        return 0.0
    by_driver = bound.kind in (stopping.COMMAND_TIMEOUT, stopping.STOP_LOCK)
    driven = stopping.driven_wheels(robot.wheels, robot.actuators)
    ramp = (stopping.driver_ramp if by_driver else stopping.quick_stop_ramp)(driven, robot.driver)
    return stopping.reachable_speed(distance, bound.reaction, ramp.deceleration)


def _reaction(distance: float, ramp: stopping.Ramp) -> float:
    """Returns the longest reaction time (s) for a stopping distance; see this module's docstring.

    The time is negative if the deceleration alone needs more than the stopping distance.
    """
    return (distance - ramp.distance) / ramp.speed if ramp.speed > 0.0 else math.inf


def _whole_milliseconds(time: float) -> float:
    return math.floor(1000.0 * time + 1e-6) / 1000.0 if math.isfinite(time) else time
