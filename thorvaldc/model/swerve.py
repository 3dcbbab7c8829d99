"""Largest yaw of a robot that loses one of its CAN buses while it drives straight ahead.

The wheels of the lost bus run on until the watchdogs of their drives act, after the time W.  If the
other wheels stop earlier, the paths of the wheels differ by D.  With the wheels at the lateral
positions y_i and their mean y_m, the yaw that fits the paths best is

    psi = D sum_lost(y_i - y_m) / sum_all(y_i - y_m)^2        D / track with one bus for each side

At the speed v:

| kind | the driver | greatest D |
| --- | --- | --- |
| ``bus_lost`` | knows that the bus is lost, and stops all wheels together | v e |
| ``bus_silent`` | only receives nothing, and stops the other wheels at once | v (W + e) |

e is the time by which the begin of the watchdog is unknown: a heartbeat period of the master, two
control cycles, and the response time of the bus.  Wheels that resist a yaw with their lateral
friction make it smaller.  ``runtime/can_base/even_stop.py`` explains the reaction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.model.bus import Bus
from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.robot import Robot, Wheel
from thorvaldc.model.stopping import DrivenWheels, bus_response_time, driven_wheels, watchdog_time

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
    beats = [
        f.period or 0.0 for f in bus.frames if f.kind == "heartbeat" and f.producer == "master"
    ]
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
