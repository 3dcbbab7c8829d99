"""The loop of teleoperation."""

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
STOPPING = 2.0
"""s at most that the robot is given to come to rest at the end."""
MESSAGE_TIME = 4.0
_AT_REST = 1e-3


def operate(
    vehicle: Vehicle,
    operator: Operator,
    source: str,
    show: Callable[[list[str]], None],
    ended: Callable[[], bool] = lambda: False,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Drive until the operator has finished or it is ``ended``, as the source of that name.

    However it ends (an interruption too), the last thing asked for is to stop, and a robot
    in this process is given the time to do so.
    """
    drawn = said = clock() - DRAW_PERIOD
    message = ""
    try:
        while not (operator.finished or ended()):
            now = clock()
            for request in operator.poll(now):
                try:
                    vehicle.call(request.service, **request.arguments)
                    message = request.service.replace("_", " ")
                except ServiceError as refused:
                    message = str(refused)
                said = now
            wanted = operator.twist(now)
            if wanted is not None:
                publish(vehicle, source, wanted)
            vehicle.cycle()
            if now - drawn >= DRAW_PERIOD:
                drawn = now
                if now - said > MESSAGE_TIME:
                    message = ""
                shown = operator.message or message
                show(status_lines(vehicle.call("state"), wanted, operator.share, shown))
    finally:
        stop(vehicle, source, clock)
        with contextlib.suppress(ConnectionError, ServiceError):
            show(status_lines(vehicle.call("state"), None, operator.share, ""))


def publish(vehicle: Vehicle, source: str, twist: Twist) -> None:
    vehicle.call("twist", source=source, vx=twist.vx, vy=twist.vy, wz=twist.wz)


def stop(vehicle: Vehicle, source: str, clock: Callable[[], float]) -> None:
    """Ask for zero until the robot stands, or has been given long enough."""
    until = clock() + STOPPING
    with contextlib.suppress(ConnectionError, ServiceError):
        while clock() < until:
            state = vehicle.call("state")
            at_rest = all(abs(value) < _AT_REST for value in state["in_force"].values())
            # Where somebody else drives, it is not for this one to stop.
            if at_rest or state["source"] not in ("", source):
                return
            publish(vehicle, source, ZERO_TWIST)
            vehicle.cycle()
