"""The robots that an operator drives, with a base driver in this process or in another process."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from thorvaldc.runtime.control.control_client import ControlClient

REMOTE_PERIOD = 0.05
"""Time in s between two commands to a driver in another process."""


class Vehicle(Protocol):
    """A robot that an operator can drive: a ``DrivenRobot`` of this process, or a remote one."""

    def call(self, service: str, **arguments: Any) -> Any:
        """Calls a service of the base driver and returns the result of the service.

        Raises ``ServiceError`` if the service fails. Raises ``ConnectionError`` if the base driver
        has ended.
        """

    def step(self) -> None:
        """Waits until the next control cycle of the base driver is due and runs the control
        cycle."""

    def shutdown(self) -> None:
        """Stops a robot of this process, and closes the connection to it."""


class RemoteVehicle:
    """A base driver in another process, connected through its control channel."""

    def __init__(self, client: ControlClient, sleep: Callable[[float], None] = time.sleep) -> None:
        self._client = client
        self._sleep = sleep

    def call(self, service: str, **arguments: Any) -> Any:
        return self._client.call(service, **arguments)

    def step(self) -> None:
        self._sleep(REMOTE_PERIOD)

    def shutdown(self) -> None:
        self._client.close()
