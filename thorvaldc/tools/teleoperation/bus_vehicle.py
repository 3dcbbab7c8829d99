"""A robot on a CAN bus that an operator drives."""

from __future__ import annotations

from typing import Any

from thorvaldc.runtime.control.driver_services import driver_description
from thorvaldc.runtime.control.runner_services import RunnerControl
from thorvaldc.runtime.runner import BaseRunner


class BusVehicle:
    """The base driver of a robot on a CAN bus, with the services of its control channel.

    The method ``cycle`` runs one control cycle of the base driver.
    """

    def __init__(self, runner: BaseRunner, control: RunnerControl) -> None:
        self.runner = runner
        self.control = control
        self.description = driver_description(runner.driver)

    def call(self, service: str, **arguments: Any) -> Any:
        return self.control.call(service, **arguments)

    def cycle(self) -> None:
        stop_flags = iter((False, True))  # run one cycle, then stop
        self.runner.run(stop=lambda: next(stop_flags))

    def close(self) -> None:
        """Stops the robot, disables the drives and sets the CANopen nodes to pre-operational."""
        self.control.close()
        self.runner.shutdown()
