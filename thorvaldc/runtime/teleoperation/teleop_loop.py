"""The loop of teleoperation: sends the operator's commands to the robot and shows the robot's
status."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.service_table import ServiceError
from thorvaldc.runtime.teleoperation.operator import Operator
from thorvaldc.runtime.teleoperation.status_lines import status_lines
from thorvaldc.runtime.teleoperation.vehicle import Vehicle

DRAW_PERIOD = 0.1
"""Time in s between two updates of the status lines."""
STOP_TIME = 2.0
"""Longest time in s that the loop waits at the end until the robot is at rest."""
MESSAGE_TIME = 4.0
"""Time in s for which a message is shown."""
_AT_REST = 1e-3
"""Speed in m/s or rad/s below which the robot counts as at rest."""


def operate(
    vehicle: Vehicle,
    operator: Operator,
    source: str,
    show: Callable[[list[str]], None],
    ended: Callable[[], bool] = lambda: False,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Drives the robot until the operator finishes or ``ended`` returns true.

    ``source`` is the name of the operator's twist source in the base driver. When the teleoperation
    loop ends, even with an exception, the loop commands the robot to stop. If the base driver runs
    in this process, the loop continues its control cycles until the robot is at rest.

    A source must command zero before it moves the robot. The loop commands this zero in the cycle
    in which the operator begins: a pressed key or dead-man button is a new command of a person.
    """
    last_draw = message_time = clock() - DRAW_PERIOD
    message, silent = "", True
    try:
        while not (operator.finished or ended()):
            now = clock()
            for request in operator.poll(now):
                message = request.service.replace("_", " ")
                try:
                    result = vehicle.call(request.service, **request.arguments)
                    message = result if isinstance(result, str) else message
                except ServiceError as error:
                    message = str(error)
                message_time = now
            commanded = operator.twist(now)
            if commanded is not None:
                try:
                    publish(vehicle, source, ZERO_TWIST if silent else commanded)
                except ServiceError as error:  # such as a source that another program publishes
                    message, message_time = str(error), now
            silent = commanded is None
            vehicle.step()
            if now - last_draw >= DRAW_PERIOD:
                last_draw = now
                if now - message_time > MESSAGE_TIME:
                    message = ""
                text = operator.message or message
                show(status_lines(vehicle.call("state"), commanded, operator.share, text))
    finally:
        stop(vehicle, source, clock)
        with contextlib.suppress(ConnectionError, ServiceError):
            show(status_lines(vehicle.call("state"), None, operator.share, ""))


def publish(vehicle: Vehicle, source: str, twist: Twist) -> None:
    """Sends a commanded twist to the base driver."""
    vehicle.call("twist", source=source, vx=twist.vx, vy=twist.vy, wz=twist.wz)


def stop(vehicle: Vehicle, source: str, clock: Callable[[], float]) -> None:
    """Commands a zero twist until the robot is at rest, for at most ``STOP_TIME`` s."""
    end = clock() + STOP_TIME
    with contextlib.suppress(ConnectionError, ServiceError):
        while clock() < end:
            state = vehicle.call("state")
            at_rest = all(abs(value) < _AT_REST for value in state["in_force"].values())
            # The zero twist must not override another twist source that drives the robot.
            if at_rest or state["source"] not in ("", source):
                return
            publish(vehicle, source, ZERO_TWIST)
            vehicle.step()
