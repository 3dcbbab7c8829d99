"""The loop of teleoperation: operator to vehicle, and status to the screen."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from thorvaldc.runtime.control.service_table import ServiceError
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.tools.teleoperation.operator import Operator
from thorvaldc.tools.teleoperation.status_lines import status_lines
from thorvaldc.tools.teleoperation.vehicle import Vehicle

DRAW_PERIOD = 0.1
"""s between two updates of the status lines."""
STOP_TIME = 2.0
"""s at most that the loop waits at the end for the robot to come to rest."""
MESSAGE_TIME = 4.0
"""s for which a message is shown."""
_AT_REST = 1e-3
"""m/s or rad/s below which the robot counts as at rest."""


def operate(
    vehicle: Vehicle,
    operator: Operator,
    source: str,
    show: Callable[[list[str]], None],
    ended: Callable[[], bool] = lambda: False,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Drives as the twist source ``source`` until the operator finishes or ``ended`` is true.

    At the end, also after an exception, the last command is a stop.  A robot in this process gets
    the time to come to rest.
    """
    last_draw = message_time = clock() - DRAW_PERIOD
    message = ""
    try:
        while not (operator.finished or ended()):
            now = clock()
            for request in operator.poll(now):
                try:
                    vehicle.call(request.service, **request.arguments)
                    message = request.service.replace("_", " ")
                except ServiceError as error:
                    message = str(error)
                message_time = now
            commanded = operator.twist(now)
            if commanded is not None:
                publish(vehicle, source, commanded)
            vehicle.cycle()
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
    """Sends a twist to the driver."""
    vehicle.call("twist", source=source, vx=twist.vx, vy=twist.vy, wz=twist.wz)


def stop(vehicle: Vehicle, source: str, clock: Callable[[], float]) -> None:
    """Commands zero until the robot is at rest, for ``STOP_TIME`` at most."""
    end = clock() + STOP_TIME
    with contextlib.suppress(ConnectionError, ServiceError):
        while clock() < end:
            state = vehicle.call("state")
            at_rest = all(abs(value) < _AT_REST for value in state["in_force"].values())
            # The stop does not override another source that drives.
            if at_rest or state["source"] not in ("", source):
                return
            publish(vehicle, source, ZERO_TWIST)
            vehicle.cycle()
