"""Services of a robot with CAN buses, in addition to the services of the base driver."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable
from typing import Any

from thorvaldc.model.robot import SAFETY_STOP
from thorvaldc.runtime.control.control_server import ControlServer
from thorvaldc.runtime.control.driver_services import (
    FORCE,
    driver_state,
    driving_services,
)
from thorvaldc.runtime.control.service_table import (
    Argument,
    Caller,
    Service,
    ServiceError,
    Services,
)
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.errors import ParameterError
from thorvaldc.runtime.multiplexer import Multiplexer, Selection
from thorvaldc.runtime.runner import BaseRunner


class RunnerControl:
    """Twist multiplexer and services of a robot with CAN buses.

    The services can be called in this process, and from other processes over a control channel.
    ``channel``: name of the control channel, or an empty text for no control channel.  The
    constructor raises ``OSError`` if another program uses the control channel.  The method ``feed``
    is the callback that the runner calls in each control cycle.
    """

    def __init__(self, runner: BaseRunner, channel: str = "") -> None:
        self.runner = runner
        self.multiplexer = Multiplexer.from_robot(runner.robot)
        self.services = Services(
            [
                *driving_services(runner.driver, self.multiplexer, runner.note),
                *runner_services(self),
            ]
        )
        runner.pre_arm_checks.append(self._check_inputs)
        longest_wait = runner.driver.time_gaps.normal
        self._server = (
            ControlServer(channel, self.services, longest_wait, self._end_program)
            if channel
            else None
        )

    @property
    def streams(self) -> list[socket.socket]:
        """Open connections of the control channel."""
        return [] if self._server is None else self._server.streams

    def feed(self, driver: BaseDriver, now: float) -> Selection:
        """Answers the requests on the control channel, and commands the twist that the twist
        multiplexer has selected."""
        self.multiplexer.notice_gap(driver, now)
        if self._server is not None:
            self._server.poll(now)
        return self.multiplexer.feed(driver, now)

    def call(self, service: str, **arguments: Any) -> Any:
        """Calls a service of the robot and returns the result.

        Raises ``ServiceError`` if the service call is refused.
        """
        return self.services.call(service, arguments, self.runner.clock.now)

    def _end_program(self, name: str) -> None:
        self.multiplexer.release(name)
        self.runner.note_end(name)

    def _check_inputs(self, runner: BaseRunner, now: float) -> list[str]:
        """Returns the reasons of the twist multiplexer why the base must not be armed."""
        multiplexer = self.multiplexer
        # The safety stop of the base, which sets its lock too, is a reason of the runner.
        stopped = runner.base.state_machine.stop_engaged
        reasons = [
            f"the stop lock `{name}` is active"
            for name in multiplexer.active_stop_locks(now)
            if not (stopped and name == SAFETY_STOP)
        ]
        reasons += [f"`{name}` commands a motion" for name in multiplexer.requests(now)]
        return reasons

    def close(self) -> None:
        if self._server is not None:
            self._server.close()


def runner_services(control: RunnerControl) -> list[Service]:
    """Returns the services of a robot with CAN buses.

    A service for robots with CAN buses replaces the base driver service with the same name.
    """
    runner, multiplexer = control.runner, control.multiplexer

    def safety_stop(now: float, caller: Caller) -> None:
        multiplexer.lock(SAFETY_STOP, True, now, caller.name)
        runner.safety_stop(owner=caller.name)

    def release_safety_stop(now: float, caller: Caller, force: bool) -> None:
        # Both stops are tried, so that this program's share of both is released.
        refusal = ""
        try:
            multiplexer.lock(SAFETY_STOP, False, now, caller.name, force=force)
        except ParameterError as error:
            refusal = str(error)
        runner.safety_stop(False, owner=caller.name, force=force)
        if refusal:
            raise ServiceError(refusal)

    def arm(now: float) -> None:
        # An armed base stays armed: no check has passed that would replace a zero twist.
        if not runner.base.armed:
            runner.arm()
            multiplexer.accept_motion(now)

    def reset_faults(now: float) -> None:
        runner.reset(commanded=bool(multiplexer.requests(now)))

    def without_time(method: Callable[..., Any]) -> Callable[..., Any]:
        return lambda now, **arguments: method(**arguments)

    return [
        Service(
            "state",
            "Return the state of the driver and its buses.",
            lambda now: runner_state(runner, multiplexer, now),
            valid_late=True,
        ),
        Service(
            "arm",
            "Accept motion, if all pre-arm checks pass; refused with every reason.",
            arm,
        ),
        Service(
            "disarm",
            "Accept no motion until `arm`; a moving robot ramps to rest.",
            without_time(runner.disarm),
            valid_late=True,
        ),
        Service("home_steering", "Home all steerings again.", without_time(runner.home_steering)),
        Service(
            "set_home_count_current_position_zero",
            "Make the present steering angle zero, of one controller or of all.",
            without_time(runner.set_home_count_current_position_zero),
            (Argument("node", "text", ""),),
        ),
        Service(
            "setup_motor_controller",
            "Write a setting of a motor controller, in its units.",
            without_time(runner.setup_motor_controller),
            (Argument("node", "text"), Argument("setting", "text"), Argument("value", "number")),
        ),
        Service(
            "safety_stop",
            "Stop all motors and switch them off, until release and reset.",
            safety_stop,
            with_caller=True,
            valid_late=True,
        ),
        Service(
            "release_safety_stop",
            "Release the safety stop of this connection (`force`: of every connection); to drive"
            " again, call `reset_faults` and `arm`.",
            release_safety_stop,
            (FORCE,),
            with_caller=True,
        ),
        Service(
            "reset_faults",
            "Leave a fault or a stop; the stop must be released, and zero commanded.",
            reset_faults,
        ),
        Service(
            "mute_devices",
            "Stop relaying frames to foreign devices, or start it again.",
            without_time(runner.mute_devices),
            (Argument("muted", "flag", True),),
        ),
        Service(
            "set_output",
            "Switch an output of an IO board.",
            without_time(runner.set_output),
            (Argument("board", "text"), Argument("output", "text"), Argument("on", "flag", True)),
        ),
        *_relay_services(runner),
    ]


def _relay_services(runner: BaseRunner) -> list[Service]:
    """Returns the services that exchange CAN frames with foreign devices."""

    def send_to_device(now: float, cob_id: int, data: str, bus: str) -> None:
        try:
            content = bytes.fromhex(data)
        except ValueError:
            raise ServiceError(f"`data` is {data!r}; it must be bytes in hexadecimal") from None
        if len(content) > 8 or not 0 <= cob_id <= 0x7FF:
            raise ServiceError("a frame has an identifier of 11 bits and at most 8 bytes")
        runner.send_to_device(cob_id, content, bus)

    def from_devices(now: float, bus: str) -> list[dict[str, Any]]:
        return [
            {"time": frame.time, "cob_id": frame.cob_id, "data": frame.data.hex()}
            for frame in runner.from_devices(bus)
        ]

    return [
        Service(
            "send_to_device",
            "Relay a frame to a foreign device, `data` in hexadecimal.",
            send_to_device,
            (Argument("cob_id", "integer"), Argument("data", "text"), Argument("bus", "text", "")),
        ),
        Service(
            "from_devices",
            "Return the frames of foreign devices since the last call.",
            from_devices,
            (Argument("bus", "text", ""),),
        ),
    ]


def runner_state(runner: BaseRunner, multiplexer: Multiplexer, now: float) -> dict[str, Any]:
    """Returns the state of a robot with CAN buses as JSON values.

    The state contains values of the base driver, the base, the batteries, the IO boards and the
    control loop.  The key ``supervisor`` contains the state of the base, such as ``ready``.  The
    key ``fault`` contains the reason why the base is in the state FAULT or ESTOP.
    """
    state = driver_state(runner.driver, multiplexer, now)
    reason = runner.base.state_machine.reason
    state["supervisor"] = runner.state.value
    state["armed"] = runner.base.armed
    state["stopped_by"] = list(runner.stop_owners)
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
    """Returns ``None`` if the number is NaN or infinite, because JSON cannot represent NaN and
    infinity."""
    return value if math.isfinite(value) else None
