"""A robot on its bus, for an operator to drive."""

from __future__ import annotations

from typing import Any

from thorvaldc.runtime.control.driver_services import driver_description
from thorvaldc.runtime.control.runner_services import RunnerControl
from thorvaldc.runtime.runner import BaseRunner


class BusVehicle:
    """A runner with its control, whose cycles are done one by one."""

    def __init__(self, runner: BaseRunner, control: RunnerControl) -> None:
        self.runner = runner
        self.control = control
        self.description = driver_description(runner.driver)

    def call(self, service: str, **arguments: Any) -> Any:
        return self.control.call(service, **arguments)

    def cycle(self) -> None:
        done = iter((False, True))
        self.runner.run(stop=lambda: next(done))

    def close(self) -> None:
        """Quick stop, disable, pre-operational."""
        self.control.close()
        self.runner.shutdown()
