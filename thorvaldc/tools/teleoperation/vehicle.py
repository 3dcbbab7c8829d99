"""The robots that an operator drives, with a base driver in this process or in another process."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from thorvaldc.runtime.control.control_client import ControlClient
from thorvaldc.runtime.control.control_server import ControlServer
from thorvaldc.runtime.control.driver_services import driver_description, driving_services
from thorvaldc.runtime.control.service_table import Services
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.time_gap import Gap, gap_text

REMOTE_PERIOD = 0.05
"""Time in s between two commands to a driver in another process."""


class Vehicle(Protocol):
    """A robot that an operator can drive through a base driver. ``description`` is the result of
    the service ``description`` of the base driver."""

    description: dict[str, Any]

    def call(self, service: str, **arguments: Any) -> Any:
        """Calls a service of the base driver and returns the result of the service.

        Raises ``ServiceError`` if the service fails. Raises ``ConnectionError`` if the base driver
        has ended.
        """

    def cycle(self) -> None:
        """Waits until the next control cycle of the base driver is due and runs the control
        cycle."""

    def close(self) -> None: ...


class SimulatedVehicle:
    """A base driver with a simulated base that runs in real time.

    ``channel`` is the name of the base driver's control channel for other programs. If ``channel``
    is empty, the base driver has no control channel. Raises ``OSError`` if another process uses the
    control channel.
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
        longest_wait = driver.time_gaps.longest_short
        self._server = (
            ControlServer(channel, self.services, longest_wait, self.multiplexer.release)
            if channel
            else None
        )
        self._clock, self._sleep = clock, sleep
        self._period = 1.0 / driver.settings.rate
        self._next_cycle = clock()
        # Difference in s between the real time and the simulated time.
        self._offset = self._next_cycle
        self.now = 0.0

    def call(self, service: str, **arguments: Any) -> Any:
        return self.services.call(service, arguments, self.now)

    def cycle(self) -> None:
        wait = self._next_cycle - self._clock()
        if wait > 0.0:
            self._sleep(wait)
        clock_time = self._clock()
        self._next_cycle += self._period
        if self._next_cycle <= clock_time:  # missed cycles are not caught up
            self._next_cycle = clock_time + self._period
        now = clock_time - self._offset
        gaps = self.driver.time_gaps
        elapsed = now - self.now
        if elapsed > gaps.normal:
            # The simulated time falls behind the clock, as the simulated robot stands still
            # meanwhile.
            self._offset += elapsed - gaps.normal
            now = clock_time - self._offset
        self.now = now
        if gaps.judge(elapsed) is Gap.LONG and math.isfinite(self.driver.state.time):
            # A slow machine is no danger to a simulated robot, but commands that waited are void.
            self.multiplexer.void(gap_text(elapsed))
            self.driver.void_commands(gap_text(elapsed))
        if self._server is not None:
            self._server.poll(now, clock_time)
        self.multiplexer.feed(self.driver, now)
        self.driver.tick(now)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
        self.driver.base.close()


class RemoteVehicle:
    """A base driver in another process, connected through its control channel."""

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
