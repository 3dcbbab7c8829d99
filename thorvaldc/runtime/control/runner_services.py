"""The services of a robot that runs on its bus."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from thorvaldc.runtime.control.control_server import ControlServer
from thorvaldc.runtime.control.driver_services import SAFETY_STOP, driver_state, driving_services
from thorvaldc.runtime.control.service_table import Argument, Service, ServiceError, Services
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.multiplexer import Multiplexer, Selection
from thorvaldc.runtime.runner import BaseRunner


class RunnerControl:
    """Who drives a runner, and what can be asked of it: by calls here and over a channel.

    Its ``feed`` is for the runner's.  ``channel`` empty: none.  Raises ``OSError`` where the
    channel is in use.
    """

    def __init__(self, runner: BaseRunner, channel: str = "") -> None:
        self.runner = runner
        self.multiplexer = Multiplexer.from_robot(runner.robot)
        self.services = Services(
            [*driving_services(runner.driver, self.multiplexer), *runner_services(self)]
        )
        self._server = ControlServer(channel, self.services) if channel else None

    def feed(self, driver: BaseDriver, now: float) -> Selection:
        """What has come over the channel, then the command of who drives."""
        if self._server is not None:
            self._server.poll(now)
        return self.multiplexer.feed(driver, now)

    def call(self, service: str, **arguments: Any) -> Any:
        """Raises ``ServiceError``."""
        return self.services.call(service, arguments, self.runner.clock.now)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()


def runner_services(control: RunnerControl) -> list[Service]:
    """What a robot on its bus can do beside driving; some of them as it is done there."""
    runner, multiplexer = control.runner, control.multiplexer

    def safety_stop(now: float) -> None:
        multiplexer.lock(SAFETY_STOP, True, now)
        runner.safety_stop()

    def release_safety_stop(now: float) -> None:
        multiplexer.lock(SAFETY_STOP, False, now)
        runner.safety_stop(False)

    def send_to_device(now: float, cob_id: int, data: str, bus: str) -> None:
        try:
            content = bytes.fromhex(data)
        except ValueError:
            raise ServiceError(f"`data` is {data!r}; bytes in hexadecimal are wanted") from None
        if len(content) > 8 or not 0 <= cob_id <= 0x7FF:
            raise ServiceError("a frame has an identifier of 11 bits and up to 8 bytes")
        runner.send_to_device(cob_id, content, bus)

    def from_devices(now: float, bus: str) -> list[dict[str, Any]]:
        return [
            {"time": came.time, "cob_id": came.cob_id, "data": came.data.hex()}
            for came in runner.from_devices(bus)
        ]

    def without_time(method: Callable[..., Any]) -> Callable[..., Any]:
        return lambda now, **arguments: method(**arguments)

    return [
        Service(
            "state",
            "What the driver and its bus do.",
            lambda now: runner_state(runner, multiplexer, now),
        ),
        Service("home_steering", "Find the steerings' zero.", without_time(runner.home_steering)),
        Service(
            "set_home_count_current_position_zero",
            "Let the steering's present angle be its zero, of one controller or of all.",
            without_time(runner.set_home_count_current_position_zero),
            (Argument("node", "text", ""),),
        ),
        Service(
            "setup_motor_controller",
            "Set one of a controller's own values, in its units.",
            without_time(runner.setup_motor_controller),
            (Argument("node", "text"), Argument("setting", "text"), Argument("value", "number")),
        ),
        Service(
            "safety_stop",
            "Stop all drives at once and take their torque, until it is released and reset.",
            safety_stop,
        ),
        Service(
            "release_safety_stop",
            "Release the stop; to drive again it takes `reset_faults`.",
            release_safety_stop,
        ),
        Service(
            "reset_faults",
            "Leave a fault or a stop: the stop released, and zero commanded.",
            without_time(runner.reset),
        ),
        Service(
            "mute_devices",
            "Pass nothing on to foreign devices, or pass it on again.",
            without_time(runner.mute_devices),
            (Argument("muted", "flag", True),),
        ),
        Service(
            "set_output",
            "Switch an output of an IO board.",
            without_time(runner.set_output),
            (Argument("board", "text"), Argument("output", "text"), Argument("on", "flag", True)),
        ),
        Service(
            "send_to_device",
            "Pass a frame on to a foreign device, `data` in hexadecimal.",
            send_to_device,
            (Argument("cob_id", "integer"), Argument("data", "text"), Argument("bus", "text", "")),
        ),
        Service(
            "from_devices",
            "What foreign devices have sent since it was asked last.",
            from_devices,
            (Argument("bus", "text", ""),),
        ),
    ]


def runner_state(runner: BaseRunner, multiplexer: Multiplexer, now: float) -> dict[str, Any]:
    """That of the driver, and ``supervisor``, why it is in a fault, batteries, IO, warnings."""
    state = driver_state(runner.driver, multiplexer, now)
    reason = runner.base.supervisor.reason
    state["supervisor"] = runner.state.value
    state["fault"] = reason or state["fault"]
    state["batteries"] = {
        name: {
            "voltage": _number(b.voltage),
            "current": _number(b.current),
            "charge": _number(b.charge),
        }
        for name, b in runner.batteries().items()
    }
    state["outputs"] = {board.node.name: dict(board.outputs) for board in runner.boards}
    state["warnings"] = runner.warnings()
    state["not_relayed"] = runner.relay_drops()
    timing = runner.timing
    state["cycles"] = timing.cycles
    state["overruns"] = timing.overruns
    return state


def _number(value: float) -> float | None:
    """JSON has no NaN: what is not known is null."""
    return value if math.isfinite(value) else None
