"""What an operator drives: a driver in this process or one that another runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from thorvaldc.runtime.control.control_client import ControlClient
from thorvaldc.runtime.control.control_server import ControlServer
from thorvaldc.runtime.control.driver_services import driver_description, driving_services
from thorvaldc.runtime.control.service_table import Services
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.multiplexer import Multiplexer

LONGEST_STEP = 0.1
"""s of simulated time in a cycle; a machine that is slower falls behind the clock."""
REMOTE_PERIOD = 0.05


class Vehicle(Protocol):
    """``description`` is the answer of the service of that name."""

    description: dict[str, Any]

    def call(self, service: str, **arguments: Any) -> Any:
        """Raises ``ServiceError``, and ``ConnectionError`` where the driver has ended."""

    def cycle(self) -> None:
        """Wait for the next control cycle and do it."""

    def close(self) -> None: ...


class SimulatedVehicle:
    """A driver on a simulated base that follows the clock, with a control channel.

    ``channel`` empty: none.  Raises ``OSError`` where the channel is in use.
    """

    def __init__(
        self,
        driver: BaseDriver,
        channel: str = "",
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.driver = driver
        self.multiplexer = Multiplexer.from_robot(driver.robot)
        self.services = Services(driving_services(driver, self.multiplexer))
        self.description = driver_description(driver)
        self._server = ControlServer(channel, self.services) if channel else None
        self._clock, self._sleep = clock, sleep
        self._period = 1.0 / driver.settings.rate
        self._next = clock()
        self._behind = self._next
        self.now = 0.0

    def call(self, service: str, **arguments: Any) -> Any:
        return self.services.call(service, arguments, self.now)

    def cycle(self) -> None:
        wait = self._next - self._clock()
        if wait > 0.0:
            self._sleep(wait)
        moment = self._clock()
        self._next += self._period
        if self._next <= moment:  # a cycle that was missed is not caught up
            self._next = moment + self._period
        now = moment - self._behind
        if now - self.now > LONGEST_STEP:
            self._behind += now - self.now - LONGEST_STEP
            now = moment - self._behind
        self.now = now
        if self._server is not None:
            self._server.poll(now)
        self.multiplexer.feed(self.driver, now)
        self.driver.tick(now)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
        self.driver.base.close()


class RemoteVehicle:
    """A driver that another process runs, by its control channel."""

    def __init__(self, client: ControlClient, sleep: Callable[[float], None] = time.sleep) -> None:
        self._client = client
        self._sleep = sleep
        self.description = client.call("description")

    def call(self, service: str, **arguments: Any) -> Any:
        return self._client.call(service, **arguments)

    def cycle(self) -> None:
        self._sleep(REMOTE_PERIOD)

    def close(self) -> None:
        self._client.close()
